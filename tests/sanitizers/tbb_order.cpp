// For the thread sanitizer, which cannot look into TBB's library: a task runs after what its
// spawner did before, and what waits for tasks goes on after all that they did. The linker sends
// calls of TBB's entry points here first (CMakeLists.txt).
#include <oneapi/tbb/detail/_small_object_pool.h>
#include <oneapi/tbb/detail/_task.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>

extern "C" {
void __tsan_acquire(void* address);
void __tsan_release(void* address);
}

namespace {

using tbb::detail::d1::execution_data;
using tbb::detail::d1::small_object_pool;
using tbb::detail::d1::task;
using tbb::detail::d1::task_group_context;
using tbb::detail::d1::wait_context;

// Spawned in the place of a task.
class OrderedTask final : public task {
 public:
  explicit OrderedTask(task& inner) : inner_(inner) { __tsan_release(this); }
  task* execute(execution_data& data) override {
    __tsan_acquire(this);
    task* const next = inner_.execute(data);  // throws: cancel() comes next
    delete this;
    return next;
  }
  task* cancel(execution_data& data) override {
    __tsan_acquire(this);
    task* const next = inner_.cancel(data);
    delete this;
    return next;
  }

 private:
  task& inner_;
};

// A wait context is a word and the count of its tasks; each ends with an atomic subtraction.
void acquireTasks(wait_context& tasks) {
  static_assert(sizeof(wait_context) == 2 * sizeof(std::uint64_t));
  reinterpret_cast<std::atomic<std::uint64_t>*>(&tasks)[1].load(std::memory_order_acquire);
}

}  // namespace

#define WRAPPED(symbol) asm("__wrap_" symbol)
#define REAL(symbol) asm("__real_" symbol)

#define SPAWN "_ZN3tbb6detail2r15spawnERNS0_2d14taskERNS2_18task_group_contextE"
void realSpawn(task& spawned, task_group_context& group) REAL(SPAWN);
void wrappedSpawn(task& spawned, task_group_context& group) WRAPPED(SPAWN);
void wrappedSpawn(task& spawned, task_group_context& group) {
  realSpawn(*new OrderedTask(spawned), group);
}

#define SPAWN_AT "_ZN3tbb6detail2r15spawnERNS0_2d14taskERNS2_18task_group_contextEt"
void realSpawnAt(task& spawned, task_group_context& group, std::uint16_t slot) REAL(SPAWN_AT);
void wrappedSpawnAt(task& spawned, task_group_context& group, std::uint16_t slot) WRAPPED(SPAWN_AT);
void wrappedSpawnAt(task& spawned, task_group_context& group, std::uint16_t slot) {
  realSpawnAt(*new OrderedTask(spawned), group, slot);
}

#define RUN                                                                                  \
  "_ZN3tbb6detail2r116execute_and_waitERNS0_2d14taskERNS2_18task_group_contextERNS2_12wait_" \
  "contextES6_"
void realRun(task& root, task_group_context& group, wait_context& tasks, task_group_context& waiter)
    REAL(RUN);
void wrappedRun(task& root, task_group_context& group, wait_context& tasks,
                task_group_context& waiter) WRAPPED(RUN);
void wrappedRun(task& root, task_group_context& group, wait_context& tasks,
                task_group_context& waiter) {
  struct Acquire {
    wait_context& tasks;
    ~Acquire() { acquireTasks(tasks); }  // also where a task threw
  } const acquire{tasks};
  realRun(root, group, tasks, waiter);
}

// The library hands freed tasks from thread to thread unseen; the heap's order is known.
#define ALLOCATE "_ZN3tbb6detail2r18allocateERPNS0_2d117small_object_poolEm"
void* wrappedAllocate(small_object_pool*& pool, std::size_t bytes) WRAPPED(ALLOCATE);
void* wrappedAllocate(small_object_pool*& pool, std::size_t bytes) {
  static std::uintptr_t nothing;  // asserted to be something, used by nobody
  pool = reinterpret_cast<small_object_pool*>(&nothing);
  return std::aligned_alloc(64, (bytes + 63) / 64 * 64);
}

#define ALLOCATE_IN ALLOCATE "RKNS2_14execution_dataE"
void* wrappedAllocateIn(small_object_pool*& pool, std::size_t bytes, const execution_data& data)
    WRAPPED(ALLOCATE_IN);
void* wrappedAllocateIn(small_object_pool*& pool, std::size_t bytes, const execution_data&) {
  return wrappedAllocate(pool, bytes);
}

#define DEALLOCATE "_ZN3tbb6detail2r110deallocateERNS0_2d117small_object_poolEPvm"
void wrappedDeallocate(small_object_pool& pool, void* object, std::size_t bytes)
    WRAPPED(DEALLOCATE);
void wrappedDeallocate(small_object_pool&, void* object, std::size_t) { std::free(object); }

#define DEALLOCATE_IN DEALLOCATE "RKNS2_14execution_dataE"
void wrappedDeallocateIn(small_object_pool& pool, void* object, std::size_t bytes,
                         const execution_data& data) WRAPPED(DEALLOCATE_IN);
void wrappedDeallocateIn(small_object_pool&, void* object, std::size_t, const execution_data&) {
  std::free(object);
}
