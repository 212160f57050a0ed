#include "pipeline/job/detachable_camera.h"

#include <chrono>
#include <condition_variable>
#include <deque>
#include <future>
#include <mutex>
#include <thread>
#include <utility>

namespace lightsketch {
namespace {

using namespace std::chrono_literals;

constexpr auto kAnswer = 10s;         // where the answer is needed
constexpr auto kShortAnswer = 200ms;  // where it is not
constexpr auto kStatistics = 50ms;
constexpr auto kClosing = 300ms;  // so that somebody else may open the camera at once

// The camera and its thread, which outlives the Camera that callers hold.
struct Owner {
  std::mutex mutex;  // Guards everything below.
  std::condition_variable changed;
  std::deque<std::function<void(Camera&)>> calls;
  bool closing = false;
  bool stuck = false;  // somebody has waited in vain for the call that is being made
};

void own(const std::shared_ptr<Owner>& owner, std::unique_ptr<Camera> camera,
         std::promise<void> closed) {
  std::unique_lock lock(owner->mutex);
  while (true) {
    owner->changed.wait(lock, [&] { return owner->closing || !owner->calls.empty(); });
    if (owner->calls.empty()) break;
    const auto call = std::move(owner->calls.front());
    owner->calls.pop_front();
    lock.unlock();
    call(*camera);
    lock.lock();
    owner->stuck = false;
  }
  lock.unlock();
  camera.reset();
  closed.set_value();
}

// What frames come through while somebody wants them.
struct Gate {
  std::mutex mutex;  // Guards both; held while they run.
  FrameCallback onFrame;
  EndCallback onEnd;
};

class DetachableCamera final : public Camera {
 public:
  explicit DetachableCamera(std::unique_ptr<Camera> camera)
      : info_(camera->info()), live_(camera->isLive()) {
    std::promise<void> closed;
    closed_ = closed.get_future();
    std::thread([owner = owner_, own_ = std::move(camera), closed = std::move(closed)]() mutable {
      own(owner, std::move(own_), std::move(closed));
    }).detach();
  }
  ~DetachableCamera() override {
    close();
    bool stuck;
    {
      const std::lock_guard lock(owner_->mutex);
      owner_->closing = true;
      stuck = owner_->stuck;
    }
    owner_->changed.notify_one();
    if (!stuck) closed_.wait_for(kClosing);
  }

  const CameraInfo& info() const override { return info_; }
  bool isLive() const override { return live_; }
  Result<CameraSettings> configure(const CameraSettings& settings) override {
    return ask([settings](Camera& camera) { return camera.configure(settings); }, kAnswer)
        .value_or(silent());
  }
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    close();
    gate_ = std::make_shared<Gate>();
    gate_->onFrame = std::move(onFrame);
    gate_->onEnd = std::move(onEnd);
    return ask(
               [gate = gate_](Camera& camera) {
                 return camera.start(
                     [gate](Frame&& frame) {
                       const std::lock_guard lock(gate->mutex);
                       if (gate->onFrame) gate->onFrame(std::move(frame));
                     },
                     [gate](const Error& error) {
                       const std::lock_guard lock(gate->mutex);
                       if (gate->onEnd) gate->onEnd(error);
                     });
               },
               kAnswer)
        .value_or(silent());
  }
  void stop() override {
    if (!gate_) return;
    close();
    ask([](Camera& camera) { return camera.stop(), 0; }, kShortAnswer);
  }
  StreamStatistics statistics() const override {
    const auto now = ask([](Camera& camera) { return camera.statistics(); }, kStatistics);
    const std::lock_guard lock(mutex_);
    if (now) statistics_ = *now;
    return statistics_;
  }
  std::vector<std::string> notes() const override {
    return ask([](Camera& camera) { return camera.notes(); }, kShortAnswer)
        .value_or(std::vector<std::string>());
  }
  bool hasFeature(const std::string& name) const override {
    return ask([name](Camera& camera) { return camera.hasFeature(name); }, kAnswer).value_or(false);
  }
  Result<void> setFeature(const std::string& name, double value) override {
    return ask([name, value](Camera& camera) { return camera.setFeature(name, value); },
               kShortAnswer)
        .value_or(silent());
  }

 private:
  // Nothing if the camera takes longer, or if it has not come back from a call before.
  template <class Call>
  auto ask(Call call, std::chrono::milliseconds patience) const
      -> std::optional<decltype(call(std::declval<Camera&>()))> {
    using Answer = decltype(call(std::declval<Camera&>()));
    auto promise = std::make_shared<std::promise<Answer>>();
    auto answer = promise->get_future();
    bool stuck;
    {
      const std::lock_guard lock(owner_->mutex);
      stuck = owner_->stuck;
      owner_->calls.push_back(
          [promise, call](Camera& camera) { promise->set_value(call(camera)); });
    }
    owner_->changed.notify_one();
    if (stuck && patience < kAnswer) patience = 0ms;
    if (answer.wait_for(patience) == std::future_status::ready) return answer.get();
    const std::lock_guard lock(owner_->mutex);
    if (answer.wait_for(0ms) == std::future_status::ready) return answer.get();
    owner_->stuck = true;
    return std::nullopt;
  }
  tl::unexpected<Error> silent() const {
    return failure(ErrorCode::kDevice, "{}: the camera does not answer", info_.address);
  }
  // No callback from now on.
  void close() {
    if (!gate_) return;
    const std::lock_guard lock(gate_->mutex);
    gate_->onFrame = nullptr;
    gate_->onEnd = nullptr;
  }

  const CameraInfo info_;
  const bool live_;
  const std::shared_ptr<Owner> owner_ = std::make_shared<Owner>();
  std::future<void> closed_;
  std::shared_ptr<Gate> gate_;
  mutable std::mutex mutex_;  // Guards statistics_.
  mutable StreamStatistics statistics_;
};

}  // namespace

std::unique_ptr<Camera> makeDetachable(std::unique_ptr<Camera> camera) {
  return std::make_unique<DetachableCamera>(std::move(camera));
}

}  // namespace lightsketch
