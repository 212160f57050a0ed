#include "calibration/radiometry/response_file.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <sstream>
#include <system_error>

#include "calibration/radiometry/summary_json.h"
#include "capture/frame/file.h"
#include "capture/frame/json.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr float kSteps = 65535;

std::string lowerExtension(const fs::path& path) {
  std::string extension = path.extension().string();
  std::ranges::transform(extension, extension.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

// "0.25" or "1/60", seconds.
std::optional<double> parseSeconds(const std::string& text) {
  const auto number = [](std::string_view part) -> std::optional<double> {
    double value = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), value);
    if (error != std::errc() || end != part.data() + part.size() || !(value > 0) ||
        !std::isfinite(value)) {
      return std::nullopt;
    }
    return value;
  };
  const auto slash = text.find('/');
  if (slash == std::string::npos) return number(text);
  const auto above = number(std::string_view(text).substr(0, slash));
  const auto below = number(std::string_view(text).substr(slash + 1));
  if (!above || !below) return std::nullopt;
  const double seconds = *above / *below;
  if (!(seconds > 0) || !std::isfinite(seconds)) return std::nullopt;
  return seconds;
}

struct NamedTime {
  std::string name;  // empty: by order
  double seconds;
};

Result<std::vector<NamedTime>> readTimes(const fs::path& path) {
  ASSIGN_OR_RETURN(const auto text, readFile(path, 1 << 20));
  std::vector<NamedTime> times;
  std::istringstream stream(text);
  int number = 0;
  for (std::string line; std::getline(stream, line);) {
    ++number;
    std::istringstream words(line);
    std::string first, second, third;
    words >> first >> second >> third;
    if (first.empty() || first[0] == '#') continue;
    const auto seconds = parseSeconds(second.empty() ? first : second);
    if (!seconds || !third.empty()) {
      return failure(ErrorCode::kCorrupt, "{}: line {}: expected '[NAME] SECONDS', found '{}'",
                     path.string(), number, line);
    }
    times.push_back({second.empty() ? std::string() : first, *seconds});
  }
  return times;
}

Result<Frame> readCountsFile(const fs::path& path) {
  cv::Mat picture;
  try {
    picture = cv::imread(path.string(), cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
    if (picture.channels() == 3 && picture.depth() == CV_8U) {
      cv::cvtColor(picture, picture, cv::COLOR_BGR2RGB);
    } else if (picture.channels() == 4 && picture.depth() == CV_8U) {
      cv::cvtColor(picture, picture, cv::COLOR_BGRA2RGB);
    }
  } catch (const cv::Exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: cannot be read as a picture ({})", path.string(),
                   error.err);
  }
  if (picture.empty()) {
    return failure(ErrorCode::kCorrupt, "{}: cannot be read as a picture", path.string());
  }
  Frame frame;
  if (picture.type() == CV_8UC1) {
    frame.format = PixelFormat::kMono8;
  } else if (picture.type() == CV_16UC1) {
    frame.format = PixelFormat::kMono16;
  } else if (picture.type() == CV_8UC3) {
    frame.format = PixelFormat::kRgb8;
  } else {
    return failure(ErrorCode::kUnsupported,
                   "{}: its samples are not raw counts that are understood; use grey of 8 or 16 "
                   "bits or RGB of 8",
                   path.string());
  }
  frame.width = picture.cols;
  frame.height = picture.rows;
  const std::size_t row = picture.elemSize() * static_cast<std::size_t>(picture.cols);
  for (int y = 0; y < picture.rows; ++y) {
    frame.bytes.insert(frame.bytes.end(), picture.ptr(y), picture.ptr(y) + row);
  }
  return frame;
}

}  // namespace

Result<void> saveResponse(const ResponseCalibration& calibration, const fs::path& path) {
  const SensorModel& sensor = calibration.sensor;
  Json json = sensorModelToJson(sensor);
  json["summary"] = toJson(calibration.summary);
  if (!sensor.darkCounts.empty()) {
    const auto [low, high] = std::ranges::minmax(sensor.darkCounts.values());
    const float step = std::max(high - low, 1e-3f) / kSteps;
    Image<std::uint16_t> picture(sensor.darkCounts.width(), sensor.darkCounts.height(),
                                 sensor.darkCounts.channels());
    for (std::size_t i = 0; i < picture.size(); ++i) {
      picture.values()[i] = static_cast<std::uint16_t>(
          std::clamp(std::round((sensor.darkCounts.values()[i] - low) / step), 0.0f, kSteps));
    }
    fs::path beside = path;
    beside.replace_extension(".dark.png");
    RETURN_IF_ERROR(writePng(beside, picture));
    ASSIGN_OR_RETURN(const auto sum, checksumOfFile(beside));
    json["dark"] = {{"file", beside.filename().string()},
                    {"checksum", sum},
                    {"countsAtZero", low},
                    {"countsPerStep", step},
                    {"exposureSeconds", sensor.darkExposureSeconds}};
  }
  return writeJsonFile(path, json);
}

Result<SensorModel> loadResponse(const fs::path& path) {
  const std::string where = path.string();
  ASSIGN_OR_RETURN(const auto json, readJsonFile(path));
  ASSIGN_OR_RETURN(auto sensor, sensorModelFromJson(json, where));
  if (!json.contains("dark")) return sensor;
  const Json& dark = json["dark"];
  ASSIGN_OR_RETURN(const auto name, jsonString(dark, "file", where));
  ASSIGN_OR_RETURN(const auto expected, jsonString(dark, "checksum", where));
  ASSIGN_OR_RETURN(const auto low, jsonNumber(dark, "countsAtZero", where));
  ASSIGN_OR_RETURN(const auto step, jsonNumber(dark, "countsPerStep", where));
  ASSIGN_OR_RETURN(sensor.darkExposureSeconds, jsonNumber(dark, "exposureSeconds", where));
  if (name.empty() || name != fs::path(name).filename().string()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'file' names '{}', which is not beside it",
                   where, name);
  }
  const fs::path beside = path.parent_path() / name;
  ASSIGN_OR_RETURN(const auto sum, checksumOfFile(beside));
  if (sum != expected) {
    return failure(ErrorCode::kCorrupt,
                   "{}: is not the dark frame that {} was saved with; calibrate again",
                   beside.string(), where);
  }
  ASSIGN_OR_RETURN(const auto picture, readImage(beside, TransferFunction::kLinear));
  const int channels = pixelFormatInfo(sensor.format).channels;
  if (picture.width() != sensor.width || picture.height() != sensor.height) {
    return failure(ErrorCode::kCorrupt, "{}: {} x {} pixels instead of {} x {}", beside.string(),
                   picture.width(), picture.height(), sensor.width, sensor.height);
  }
  sensor.darkCounts = Image<float>(sensor.width, sensor.height, channels);
  for (int y = 0; y < sensor.height; ++y) {
    for (int x = 0; x < sensor.width; ++x) {
      for (int c = 0; c < channels; ++c) {
        sensor.darkCounts(x, y, c) = static_cast<float>(
            low + step * static_cast<double>(picture(x, y, c)) * static_cast<double>(kSteps));
      }
    }
  }
  return sensor;
}

Result<std::vector<Frame>> readBracketFolder(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> pictures, texts;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string extension = lowerExtension(entry.path());
    if (extension == ".txt") texts.push_back(entry.path());
    if (extension == ".png" || extension == ".tif" || extension == ".tiff" || extension == ".jpg" ||
        extension == ".jpeg") {
      pictures.push_back(entry.path());
    }
  }
  if (error) {
    return failure(ErrorCode::kNotFound, "{}: {}", folder.string(), error.message());
  }
  if (pictures.empty()) {
    return failure(ErrorCode::kNotFound, "{}: holds no PNG, TIFF or JPEG pictures",
                   folder.string());
  }
  if (texts.size() != 1) {
    return failure(ErrorCode::kNotFound,
                   "{}: needs exactly one text file of exposure times (a line per picture, 'NAME "
                   "SECONDS' or 'SECONDS'), found {}",
                   folder.string(), texts.size());
  }
  std::ranges::sort(pictures);
  ASSIGN_OR_RETURN(const auto times, readTimes(texts[0]));
  const bool named = !times.empty() && !times[0].name.empty();
  if (!named && times.size() != pictures.size()) {
    return failure(ErrorCode::kCorrupt, "{}: {} exposure times for {} pictures", texts[0].string(),
                   times.size(), pictures.size());
  }
  std::vector<Frame> frames;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const std::string name = pictures[i].filename().string();
    const auto time = named ? std::ranges::find(times, name, &NamedTime::name)
                            : times.begin() + static_cast<std::ptrdiff_t>(i);
    if (time == times.end()) {
      return failure(ErrorCode::kCorrupt, "{}: no exposure time for {}", texts[0].string(), name);
    }
    ASSIGN_OR_RETURN(auto frame, readCountsFile(pictures[i]));
    frame.metadata.id = i;
    frame.metadata.exposureSeconds = time->seconds;
    frames.push_back(std::move(frame));
  }
  return frames;
}

}  // namespace lightsketch
