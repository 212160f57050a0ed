// What a camera callback hands its frames to.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

#include "capture/frame/time.h"

namespace lightsketch {

// Thread-safe. Full: what comes is refused and counted.
template <class T>
class BoundedQueue {
 public:
  explicit BoundedQueue(std::size_t capacity) : capacity_(capacity) {}

  bool push(T&& item) {
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return false;
      if (items_.size() >= capacity_) {
        ++refused_;
        return false;
      }
      items_.push_back(std::move(item));
    }
    ready_.notify_one();
    return true;
  }
  // For what must not be refused.
  void pushAnyway(T&& item) {
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return;
      items_.push_back(std::move(item));
    }
    ready_.notify_one();
  }
  // Waits. Nothing once the queue is closed and empty.
  std::optional<T> pop() {
    std::unique_lock lock(mutex_);
    ready_.wait(lock, [&] { return closed_ || !items_.empty(); });
    return take();
  }
  // The same, but also nothing when none has come for so long.
  std::optional<T> popWithin(Duration patience) {
    std::unique_lock lock(mutex_);
    ready_.wait_for(lock, patience, [&] { return closed_ || !items_.empty(); });
    return take();
  }
  bool over() const {
    const std::lock_guard lock(mutex_);
    return closed_ && items_.empty();
  }
  // What is in it is still handed out, unless `discard`.
  void close(bool discard = false) {
    {
      const std::lock_guard lock(mutex_);
      closed_ = true;
      if (discard) items_.clear();
    }
    ready_.notify_all();
  }
  std::uint64_t refused() const {
    const std::lock_guard lock(mutex_);
    return refused_;
  }

 private:
  std::optional<T> take() {
    if (items_.empty()) return std::nullopt;
    T item = std::move(items_.front());
    items_.pop_front();
    return item;
  }

  const std::size_t capacity_;
  mutable std::mutex mutex_;  // Guards everything below.
  std::condition_variable ready_;
  std::deque<T> items_;
  std::uint64_t refused_ = 0;
  bool closed_ = false;
};

}  // namespace lightsketch
