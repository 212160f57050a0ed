// A running camera as a picture: between the camera's thread and the screen.
#pragma once

#include <QImage>
#include <QObject>
#include <QSize>
#include <array>
#include <atomic>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <thread>
#include <vector>

#include "capture/device/camera.h"
#include "capture/frame/frame.h"

namespace lightsketch {

// A frame made ready for the screen.
struct ViewPicture {
  QImage image;     // as large as it is shown; encoded for the screen
  QSize frameSize;  // pixels of the camera, to which overlays refer
  FrameMetadata metadata;
  // Counts, 64 bins from 0 to the format's largest; three channels, all alike for grey.
  std::array<std::array<std::uint32_t, 64>, 3> histogram{};
  double saturatedFraction = 0;
  double focus = 0;  // mean squared gradient against mean squared brightness; larger is sharper
};

// One camera's. The camera's thread publishes, a thread of its own converts the newest frame
// (frames that come meanwhile are let go: a view may drop, a recording may not), the UI thread
// shows. All functions are thread-safe; pictureReady() comes from the converting thread, so connect
// to it from an object of the UI thread.
class LiveView final : public QObject {
  Q_OBJECT
 public:
  explicit LiveView(QObject* parent = nullptr);
  ~LiveView() override;

  void publish(const Frame& frame);
  // The camera is gone or closed: no picture.
  void clear();

  // The newest picture; nothing if there is none.
  std::shared_ptr<const ViewPicture> picture() const;
  // The newest frame as the camera sent it.
  std::shared_ptr<const Frame> frame() const;
  // `viewer` wants pictures this large, in device pixels, aspect kept; empty: it does not look any
  // more. The largest wish counts; without any no pictures are made.
  void setSize(const void* viewer, QSize size);
  // Paint saturated pixels red, sharp edges yellow.
  void setShowSaturation(bool on) { showSaturation_ = on; }
  void setShowFocus(bool on) { showFocus_ = on; }
  // Frames published each second, over the last second.
  double framesPerSecond() const;

 Q_SIGNALS:
  void pictureReady();

 private:
  void convert(const std::stop_token& stop);
  QSize wantedSize() const;

  std::atomic<bool> showSaturation_ = false;
  std::atomic<bool> showFocus_ = false;
  mutable std::mutex mutex_;  // Guards everything below.
  std::condition_variable_any changed_;
  std::shared_ptr<const Frame> frame_;
  std::shared_ptr<const ViewPicture> picture_;
  std::map<const void*, QSize> sizes_;
  bool fresh_ = false;
  std::vector<TimePoint> arrivals_;
  std::jthread thread_;
};

// A camera that shows what it delivers: everything goes to `camera`, frames also to `view`.
std::unique_ptr<Camera> tapped(std::unique_ptr<Camera> camera, std::shared_ptr<LiveView> view);

// For the screen, as large as fits into `size`. Linear counts are sRGB-encoded. Fills everything of
// the picture but metadata.
ViewPicture toPicture(const Frame& frame, QSize size, bool showSaturation, bool showFocus);

}  // namespace lightsketch
