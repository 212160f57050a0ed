#include "ui/app/live_view.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "capture/frame/pixel_format.h"
#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

constexpr std::uint32_t kSaturatedColour = 0xffff2a2a;
constexpr std::uint32_t kSharpColour = 0xffffd400;
constexpr int kCodes = 4096;  // counts are looked up as 12 bits; an 8-bit screen shows no more

// Screen code of a count's upper 12 bits.
std::vector<std::uint8_t> screenCodes() {
  std::vector<std::uint8_t> codes(kCodes);
  for (int i = 0; i < kCodes; ++i) {
    codes[static_cast<std::size_t>(i)] =
        srgbEncode8(static_cast<float>(i) / static_cast<float>(kCodes - 1));
  }
  return codes;
}

using Codes = std::array<std::uint16_t, 3>;

// What the screen shows of a frame, a line at a time: pixels of a colour or grey frame, 2 x 2 of a
// mosaic.
class Reader {
 public:
  explicit Reader(const Frame& frame)
      : frame_(frame), info_(pixelFormatInfo(frame.format)), line_(samples()), next_(samples()) {}

  int width() const { return info_.isBayer ? frame_.width / 2 : frame_.width; }
  int height() const { return info_.isBayer ? frame_.height / 2 : frame_.height; }

  void read(int y, std::vector<Codes>& rgb) {
    const auto columns = static_cast<std::size_t>(width());
    rgb.resize(columns);
    if (info_.isBayer) {
      decode(2 * y + info_.redY, line_);  // the line with the red samples
      decode(2 * y + 1 - info_.redY, next_);
      const auto red = static_cast<std::size_t>(info_.redX);
      for (std::size_t x = 0; x < columns; ++x) {
        const int green = (line_[2 * x + 1 - red] + next_[2 * x + red]) / 2;
        rgb[x] = {line_[2 * x + red], static_cast<std::uint16_t>(green), next_[2 * x + 1 - red]};
      }
      return;
    }
    decode(y, line_);
    if (info_.channels == 1) {
      for (std::size_t x = 0; x < columns; ++x) rgb[x] = {line_[x], line_[x], line_[x]};
    } else {
      for (std::size_t x = 0; x < columns; ++x) {
        rgb[x] = {line_[3 * x], line_[3 * x + 1], line_[3 * x + 2]};
      }
    }
  }

 private:
  std::size_t samples() const {
    return static_cast<std::size_t>(frame_.width) * static_cast<std::size_t>(info_.channels);
  }
  void decode(int y, std::vector<std::uint16_t>& codes) const {
    const std::uint8_t* bytes =
        frame_.bytes.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(frame_.width) *
                                  static_cast<std::size_t>(info_.bytesPerPixel);
    if (info_.bits <= 8) {
      for (std::size_t i = 0; i < codes.size(); ++i) {
        codes[i] = static_cast<std::uint16_t>(bytes[i] << 4 | bytes[i] >> 4);
      }
      return;
    }
    const int up = std::max(0, 12 - info_.bits);
    const int down = std::max(0, info_.bits - 12);
    for (std::size_t i = 0; i < codes.size(); ++i) {
      const int count = bytes[2 * i] | bytes[2 * i + 1] << 8;
      codes[i] = static_cast<std::uint16_t>(std::min((count << up) >> down, kCodes - 1));
    }
  }

  const Frame& frame_;
  const PixelFormatInfo& info_;
  std::vector<std::uint16_t> line_;
  std::vector<std::uint16_t> next_;
};

class TappedCamera final : public Camera {
 public:
  TappedCamera(std::unique_ptr<Camera> camera, std::shared_ptr<LiveView> view)
      : camera_(std::move(camera)), view_(std::move(view)) {}
  ~TappedCamera() override {
    camera_.reset();
    view_->clear();
  }

  const CameraInfo& info() const override { return camera_->info(); }
  Result<CameraSettings> configure(const CameraSettings& settings) override {
    return camera_->configure(settings);
  }
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    return camera_->start(
        [this, onFrame = std::move(onFrame)](Frame&& frame) {
          view_->publish(frame);
          onFrame(std::move(frame));
        },
        std::move(onEnd));
  }
  void stop() override { camera_->stop(); }
  StreamStatistics statistics() const override { return camera_->statistics(); }
  bool isLive() const override { return camera_->isLive(); }
  bool hasFeature(const std::string& name) const override { return camera_->hasFeature(name); }
  Result<void> setFeature(const std::string& name, double value) override {
    return camera_->setFeature(name, value);
  }

 private:
  std::unique_ptr<Camera> camera_;
  const std::shared_ptr<LiveView> view_;
};

}  // namespace

LiveView::LiveView(QObject* parent)
    : QObject(parent), thread_([this](const std::stop_token& stop) { convert(stop); }) {}

LiveView::~LiveView() {
  thread_.request_stop();
  thread_.join();
}

void LiveView::publish(const Frame& frame) {
  auto copy = std::make_shared<const Frame>(frame);
  {
    const std::lock_guard lock(mutex_);
    frame_ = std::move(copy);
    fresh_ = true;
    const TimePoint now = Clock::now();
    arrivals_.push_back(now);
    std::erase_if(arrivals_, [&](TimePoint t) { return toSeconds(now - t) > 1; });
  }
  changed_.notify_one();
}

void LiveView::clear() {
  {
    const std::lock_guard lock(mutex_);
    frame_.reset();
    picture_.reset();
    fresh_ = false;
    arrivals_.clear();
  }
  Q_EMIT pictureReady();
}

std::shared_ptr<const ViewPicture> LiveView::picture() const {
  const std::lock_guard lock(mutex_);
  return picture_;
}

std::shared_ptr<const Frame> LiveView::frame() const {
  const std::lock_guard lock(mutex_);
  return frame_;
}

void LiveView::setSize(const void* viewer, QSize size) {
  {
    const std::lock_guard lock(mutex_);
    const QSize before = wantedSize();
    if (size.isEmpty()) {
      sizes_.erase(viewer);
    } else {
      sizes_[viewer] = size;
    }
    if (wantedSize() == before) return;
    fresh_ = frame_ != nullptr;
  }
  changed_.notify_one();
}

QSize LiveView::wantedSize() const {
  QSize size;
  for (const auto& [viewer, wanted] : sizes_) size = size.expandedTo(wanted);
  return size;
}

double LiveView::framesPerSecond() const {
  const std::lock_guard lock(mutex_);
  const TimePoint now = Clock::now();
  return static_cast<double>(std::count_if(arrivals_.begin(), arrivals_.end(),
                                           [&](TimePoint t) { return toSeconds(now - t) <= 1; }));
}

void LiveView::convert(const std::stop_token& stop) {
  while (true) {
    std::shared_ptr<const Frame> frame;
    QSize size;
    {
      std::unique_lock lock(mutex_);
      if (!changed_.wait(lock, stop, [&] { return fresh_ && !wantedSize().isEmpty(); })) return;
      frame = frame_;
      size = wantedSize();
      fresh_ = false;
    }
    auto picture =
        std::make_shared<ViewPicture>(toPicture(*frame, size, showSaturation_, showFocus_));
    picture->metadata = frame->metadata;
    {
      const std::lock_guard lock(mutex_);
      if (!frame_) continue;  // cleared meanwhile
      picture_ = std::move(picture);
    }
    Q_EMIT pictureReady();
  }
}

std::unique_ptr<Camera> tapped(std::unique_ptr<Camera> camera, std::shared_ptr<LiveView> view) {
  return std::make_unique<TappedCamera>(std::move(camera), std::move(view));
}

ViewPicture toPicture(const Frame& frame, QSize size, bool showSaturation, bool showFocus) {
  Reader reader(frame);
  const int width = reader.width();
  const int height = reader.height();
  ViewPicture picture;
  picture.frameSize = {frame.width, frame.height};
  picture.image = QImage(width, height, QImage::Format_RGB32);
  const std::vector<std::uint8_t> codes = screenCodes();
  constexpr int kSaturated = kCodes - kCodes / 256;
  // Gradients of green, square on square, so that brightness cancels.
  double gradients = 0;
  double squares = 0;
  std::size_t saturated = 0;
  std::vector<Codes> line;
  std::vector<Codes> above;
  constexpr float kSharp = 0.02f;          // squared gradient against squared brightness
  constexpr float kDark = kCodes / 50.0f;  // below, noise looks sharp

  for (int y = 0; y < height; ++y) {
    reader.read(y, line);
    auto* pixels = reinterpret_cast<QRgb*>(picture.image.scanLine(y));
    float lineGradients = 0;
    float lineSquares = 0;
    for (std::size_t x = 0; x < line.size(); ++x) {
      const Codes& rgb = line[x];
      pixels[x] = qRgb(codes[rgb[0]], codes[rgb[1]], codes[rgb[2]]);
      const bool burnt = std::max({rgb[0], rgb[1], rgb[2]}) >= kSaturated;
      saturated += burnt;
      for (std::size_t c = 0; c < 3; ++c) ++picture.histogram[c][rgb[c] / (kCodes / 64)];
      if (x > 0 && y > 0) {
        const float here = rgb[1];
        const float dx = here - line[x - 1][1];
        const float dy = here - above[x][1];
        const float squared = dx * dx + dy * dy;
        lineGradients += squared;
        lineSquares += here * here;
        if (showFocus && squared > kSharp * here * here && here > kDark) pixels[x] = kSharpColour;
      }
      if (showSaturation && burnt) pixels[x] = kSaturatedColour;
    }
    gradients += lineGradients;
    squares += lineSquares;
    line.swap(above);
  }
  picture.saturatedFraction =
      static_cast<double>(saturated) / std::max(1.0, static_cast<double>(width) * height);
  picture.focus = squares > 0 ? gradients / squares : 0;
  const QSize shown = QSize(width, height).scaled(size, Qt::KeepAspectRatio);
  if (shown.width() != width) {
    picture.image = picture.image.scaled(shown, Qt::IgnoreAspectRatio, Qt::SmoothTransformation);
  }
  return picture;
}

}  // namespace lightsketch
