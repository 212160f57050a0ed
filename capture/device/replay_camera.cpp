#include "capture/device/replay_camera.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstring>
#include <limits>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <span>
#include <stop_token>
#include <thread>
#include <utility>
#include <vector>

#include "capture/frame/file.h"
#include "capture/frame/json.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFormat = "lightsketch-frames";
constexpr int kFormatVersion = 1;
constexpr const char* kJournal = "frames.jsonl";

struct Entry {
  std::string where;  // journal and line, for messages
  fs::path file;
  std::string checksum;  // empty: unknown
  PixelFormat format = PixelFormat::kMono8;
  FrameMetadata metadata;
};

Result<Entry> parseEntry(const Json& line, const fs::path& folder, const std::string& where) {
  Entry entry;
  entry.where = where;
  ASSIGN_OR_RETURN(const std::string file, jsonString(line, "file", where));
  const fs::path name(file);
  if (name.empty() || name != name.filename()) {
    return failure(ErrorCode::kCorrupt, "{}: file '{}' is not a plain file name", where, file);
  }
  entry.file = folder / name;
  std::error_code ignored;
  if (!fs::is_regular_file(entry.file, ignored)) {
    return failure(ErrorCode::kNotFound, "{}: file '{}' is missing", where, entry.file.string());
  }
  if (line.contains("checksum")) {
    ASSIGN_OR_RETURN(entry.checksum, jsonString(line, "checksum", where));
  }
  ASSIGN_OR_RETURN(const std::string format, jsonString(line, "pixelFormat", where));
  const auto known = pixelFormatFromName(format);
  if (!known) {
    return failure(ErrorCode::kUnsupported, "{}: unknown pixel format '{}'", where, format);
  }
  entry.format = *known;

  constexpr std::int64_t kMax = std::numeric_limits<std::int64_t>::max();
  FrameMetadata& metadata = entry.metadata;
  ASSIGN_OR_RETURN(const auto id, jsonInteger(line, "id", where, 0, kMax));
  ASSIGN_OR_RETURN(metadata.deviceTimeNs, jsonInteger(line, "deviceTimeNs", where, -kMax, kMax));
  ASSIGN_OR_RETURN(const double mid, jsonNumber(line, "midExposureSeconds", where));
  ASSIGN_OR_RETURN(const double sigma, jsonNumber(line, "timeUncertaintySeconds", where));
  ASSIGN_OR_RETURN(metadata.exposureSeconds, jsonNumber(line, "exposureSeconds", where));
  ASSIGN_OR_RETURN(metadata.gainDb, jsonNumber(line, "gainDb", where));
  constexpr double kMaxSeconds = 1e9;  // well inside 64-bit nanoseconds
  if (std::abs(mid) > kMaxSeconds || !(sigma >= 0 && sigma <= kMaxSeconds) ||
      !(metadata.exposureSeconds >= 0 && metadata.exposureSeconds <= kMaxSeconds)) {
    return failure(ErrorCode::kCorrupt, "{}: a time is out of range", where);
  }
  metadata.id = static_cast<std::uint64_t>(id);
  metadata.midExposure = TimePoint(fromSeconds(mid));
  metadata.timeUncertainty = fromSeconds(sigma);
  return entry;
}

// Reads and checks one picture.
Result<Frame> load(const Entry& entry) {
  const std::string where = fmt::format("{}: {}", entry.where, entry.file.string());
  ASSIGN_OR_RETURN(std::string content, readFile(entry.file));
  // Before decoding: libpng would report damage on the terminal.
  if (!entry.checksum.empty() && checksum(content) != entry.checksum) {
    return failure(ErrorCode::kCorrupt, "{}: damaged (its checksum differs)", where);
  }
  cv::Mat image;
  try {
    if (!content.empty()) {
      image = cv::imdecode(cv::Mat(1, static_cast<int>(content.size()), CV_8U, content.data()),
                           cv::IMREAD_UNCHANGED);
    }
  } catch (const cv::Exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: cannot be decoded ({})", where, error.err);
  }
  if (image.empty()) {
    return failure(ErrorCode::kCorrupt, "{}: damaged or not a picture", where);
  }
  const PixelFormatInfo& info = pixelFormatInfo(entry.format);
  const int type = CV_MAKETYPE(info.bits <= 8 ? CV_8U : CV_16U, info.channels);
  if (image.type() != type) {
    return failure(ErrorCode::kCorrupt, "{}: holds {} x {} bits, but {} needs {} x {}", where,
                   image.channels(), 8 * image.elemSize1(), info.name, info.channels,
                   info.bits <= 8 ? 8 : 16);
  }

  Frame frame;
  frame.metadata = entry.metadata;
  frame.format = entry.format;
  frame.width = image.cols;
  frame.height = image.rows;
  const std::size_t rowBytes = static_cast<std::size_t>(image.cols) * image.elemSize();
  frame.bytes.resize(rowBytes * static_cast<std::size_t>(image.rows));
  for (int y = 0; y < image.rows; ++y) {
    std::uint8_t* row = frame.bytes.data() + static_cast<std::size_t>(y) * rowBytes;
    std::memcpy(row, image.ptr(y), rowBytes);
    if (info.channels == 3) {  // OpenCV's order is blue, green, red
      for (std::size_t x = 0; x < rowBytes; x += 3) std::swap(row[x], row[x + 2]);
    }
    if (info.bits == 10 || info.bits == 12) {
      const auto* samples = image.ptr<std::uint16_t>(y);
      const auto largest = *std::max_element(samples, samples + image.cols);
      if (largest >> info.bits != 0) {
        return failure(ErrorCode::kCorrupt, "{}: row {} holds {}, more than {} bits can", where, y,
                       largest, info.bits);
      }
    }
  }
  return frame;
}

class ReplayCamera final : public Camera {
 public:
  ReplayCamera(CameraInfo info, std::vector<Entry> entries, Frame first, double rate,
               double framesPerSecond)
      : info_(std::move(info)),
        entries_(std::move(entries)),
        first_(std::move(first)),
        rate_(rate),
        framesPerSecond_(framesPerSecond) {}
  ~ReplayCamera() override { stop(); }

  const CameraInfo& info() const override { return info_; }

  Result<CameraSettings> configure(const CameraSettings&) override {
    return CameraSettings{first_.format, Region{0, 0, first_.width, first_.height},
                          first_.metadata.exposureSeconds, first_.metadata.gainDb,
                          framesPerSecond_, ""};
  }

  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    if (player_.joinable()) {
      return failure(ErrorCode::kInvalidArgument, "{}: plays already", info_.address);
    }
    delivered_ = 0;
    player_ = std::jthread([this, frame = std::move(onFrame), end = std::move(onEnd)](
                               std::stop_token stop) { play(stop, frame, end); });
    return {};
  }

  void stop() override { player_ = {}; }

  bool isLive() const override { return false; }
  StreamStatistics statistics() const override {
    StreamStatistics statistics;
    statistics.delivered = delivered_;
    return statistics;
  }
  bool hasFeature(const std::string&) const override { return false; }
  Result<void> setFeature(const std::string& name, double) override {
    return failure(ErrorCode::kUnsupported, "{}: a replay has no feature '{}'", info_.address,
                   name);
  }

 private:
  void play(std::stop_token stop, const FrameCallback& onFrame, const EndCallback& onEnd) {
    const TimePoint begin = Clock::now();
    std::mutex mutex;
    std::condition_variable_any wake;
    std::unique_lock lock(mutex);
    for (const Entry& entry : entries_) {
      auto frame = load(entry);
      if (frame && (frame->width != first_.width || frame->height != first_.height ||
                    frame->format != first_.format)) {
        frame = failure(ErrorCode::kCorrupt, "{}: {} is not of the first frame's size and format",
                        entry.where, entry.file.string());
      }
      if (!frame) {
        if (onEnd) onEnd(frame.error());
        return;
      }
      if (rate_ > 0) {
        const Duration offset = entry.metadata.midExposure - first_.metadata.midExposure;
        wake.wait_until(lock, stop, begin + fromSeconds(toSeconds(offset) / rate_),
                        [&] { return stop.stop_requested(); });
      }
      if (stop.stop_requested()) return;
      frame->metadata.arrival = Clock::now();
      ++delivered_;
      onFrame(std::move(*frame));
    }
    if (onEnd && !stop.stop_requested()) {
      onEnd(Error{ErrorCode::kCancelled, info_.address + ": the recording has ended"});
    }
  }

  const CameraInfo info_;
  const std::vector<Entry> entries_;
  const Frame first_;
  const double rate_;
  const double framesPerSecond_;
  std::atomic<std::uint64_t> delivered_ = 0;
  std::jthread player_;  // last: it ends before the rest does
};

}  // namespace

Result<std::unique_ptr<Camera>> openReplayCamera(const fs::path& folder, double rate) {
  const fs::path journal = folder / kJournal;
  std::error_code ignored;
  if (!fs::exists(journal, ignored)) {
    return failure(ErrorCode::kNotFound, "replay:{}: no recorded stream there ({} is missing)",
                   folder.string(), journal.string());
  }
  ASSIGN_OR_RETURN(const std::string text, readFile(journal));
  CameraInfo info;
  info.address = "replay:" + folder.string();
  std::vector<Entry> entries;
  int number = 0;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string line = text.substr(begin, end - begin);
    begin = end + 1;
    const std::string where = fmt::format("{}: line {}", journal.string(), ++number);
    if (line.empty()) continue;
    ASSIGN_OR_RETURN(const Json object, parseJson(line, where));
    if (number == 1) {
      RETURN_IF_ERROR(checkFormat(object, kFormat, kFormatVersion, where));
      ASSIGN_OR_RETURN(info.vendor, jsonString(object, "vendor", where));
      ASSIGN_OR_RETURN(info.model, jsonString(object, "model", where));
      ASSIGN_OR_RETURN(info.serial, jsonString(object, "serial", where));
      continue;
    }
    ASSIGN_OR_RETURN(Entry entry, parseEntry(object, folder, where));
    entries.push_back(std::move(entry));
  }
  if (entries.empty()) {
    return failure(ErrorCode::kCorrupt, "{}: holds no frame", journal.string());
  }
  ASSIGN_OR_RETURN(Frame first, load(entries.front()));
  const double duration =
      toSeconds(entries.back().metadata.midExposure - entries.front().metadata.midExposure);
  const double framesPerSecond =
      duration > 0 ? static_cast<double>(entries.size() - 1) / duration : 0;
  return std::make_unique<ReplayCamera>(std::move(info), std::move(entries), std::move(first), rate,
                                        framesPerSecond);
}

ReplayWriter::ReplayWriter(fs::path folder, std::ofstream journal)
    : folder_(std::move(folder)), journal_(std::move(journal)) {}

Result<ReplayWriter> ReplayWriter::create(const fs::path& folder, const CameraInfo& camera) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error || !fs::is_empty(folder, error) || error) {
    return failure(ErrorCode::kIo, "{}: {}", folder.string(),
                   error ? error.message() : "is not empty; choose a new folder");
  }
  std::ofstream journal(folder / kJournal);
  const Json header = {{"format", kFormat},
                       {"formatVersion", kFormatVersion},
                       {"vendor", camera.vendor},
                       {"model", camera.model},
                       {"serial", camera.serial}};
  journal << header.dump(-1, ' ', false, Json::error_handler_t::replace) << std::endl;
  if (!journal) {
    return failure(ErrorCode::kIo, "{}: cannot be written", (folder / kJournal).string());
  }
  return ReplayWriter(folder, std::move(journal));
}

Result<void> ReplayWriter::write(const Frame& frame) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const std::size_t rowBytes =
      static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(info.bytesPerPixel);
  if (frame.width < 1 || frame.height < 1 ||
      frame.bytes.size() != rowBytes * static_cast<std::size_t>(frame.height)) {
    return failure(ErrorCode::kInvalidArgument, "{}: frame {} is not whole", folder_.string(),
                   frame.metadata.id);
  }
  cv::Mat image(frame.height, frame.width,
                CV_MAKETYPE(info.bits <= 8 ? CV_8U : CV_16U, info.channels));
  for (int y = 0; y < frame.height; ++y) {
    std::uint8_t* row = image.ptr(y);
    std::memcpy(row, frame.bytes.data() + static_cast<std::size_t>(y) * rowBytes, rowBytes);
    if (info.channels == 3) {
      for (std::size_t x = 0; x < rowBytes; x += 3) std::swap(row[x], row[x + 2]);
    }
  }
  std::vector<std::uint8_t> png;
  try {
    // Level 1: three times as fast as the default for a few percent more bytes.
    cv::imencode(".png", image, png, {cv::IMWRITE_PNG_COMPRESSION, 1});
  } catch (const cv::Exception& error) {
    return failure(ErrorCode::kIo, "{}: frame {} cannot be encoded ({})", folder_.string(),
                   frame.metadata.id, error.err);
  }

  const std::string file = fmt::format("{:06}.png", count_);
  std::ofstream picture(folder_ / file, std::ios::binary);
  picture.write(reinterpret_cast<const char*>(png.data()),
                static_cast<std::streamsize>(png.size()));
  picture.close();
  const FrameMetadata& metadata = frame.metadata;
  const Json line = {{"file", file},
                     {"pixelFormat", info.name},
                     {"id", metadata.id},
                     {"deviceTimeNs", metadata.deviceTimeNs},
                     {"midExposureSeconds", toSeconds(metadata.midExposure.time_since_epoch())},
                     {"timeUncertaintySeconds", toSeconds(metadata.timeUncertainty)},
                     {"exposureSeconds", metadata.exposureSeconds},
                     {"gainDb", metadata.gainDb},
                     {"checksum", checksum(std::as_bytes(std::span(png)))}};
  if (picture) journal_ << line.dump() << std::endl;
  if (!picture || !journal_) {
    std::error_code ignored;
    fs::remove(folder_ / file, ignored);
    return failure(ErrorCode::kIo, "{}: cannot be written; is the disk full?",
                   (folder_ / file).string());
  }
  ++count_;
  return {};
}

}  // namespace lightsketch
