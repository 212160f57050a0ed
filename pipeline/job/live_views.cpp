#include "pipeline/job/live_views.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <utility>

#include "capture/frame/time.h"
#include "pipeline/hdr/linearise.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

// Pictures of one moment: the board stands still, so they need not be of the same instant.
constexpr double kTogetherSeconds = 0.25;
constexpr double kSilenceSeconds = 5;

// A camera and its latest frame; older ones are let go.
struct Stream {
  explicit Stream(Camera& source) : camera(source) {}
  ~Stream() { camera.stop(); }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  Camera& camera;
  std::optional<Frame> latest;  // guarded by the collection's mutex

  // The collecting thread's.
  std::optional<ViewCollector> collector;
  std::optional<BoardView> view;  // in `shown`
  TimePoint shownTime;
  ViewVerdict verdict = ViewVerdict::kNoBoard;
  std::optional<Frame> shown;
  std::vector<Eigen::Vector2d> corners;  // in `shown`, whatever the verdict
  std::shared_ptr<const std::vector<Eigen::Vector2d>> kept =
      std::make_shared<std::vector<Eigen::Vector2d>>();
};

std::vector<Eigen::Vector2d> pixelsOf(const BoardView& view) {
  std::vector<Eigen::Vector2d> pixels;
  for (const BoardCorner& corner : view.corners) pixels.push_back(corner.pixel);
  return pixels;
}

// Detection wants brightness, not calibration.
Result<BoardDetection> detectIn(const Frame& frame, const BoardGeometry& board) {
  if (frame.format == PixelFormat::kMono8) {
    Image<std::uint8_t> grey(frame.width, frame.height, 1);
    if (frame.bytes.size() != grey.size()) {
      return failure(ErrorCode::kDevice, "frame {}: {} bytes for {} x {} pixels", frame.metadata.id,
                     frame.bytes.size(), frame.width, frame.height);
    }
    std::copy(frame.bytes.begin(), frame.bytes.end(), grey.data());
    return detectBoard(grey, board);
  }
  ASSIGN_OR_RETURN(const LinearFrame linear, linearise(frame));
  return detectBoard(linear.radiance, board);
}

Result<void> keepPicture(const Frame& frame, const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const LinearFrame linear, linearise(frame));
  return writePng(path, toSrgb8(linear.radiance, 1));
}

}  // namespace

Result<LiveViews> collectLiveViews(std::span<Camera* const> cameras, const LiveViewOptions& options,
                                   Progress& progress, std::stop_token stop,
                                   const std::function<void(const LiveViewState&)>& onState) {
  if (!options.keep.empty()) {
    std::error_code error;
    for (std::size_t i = 0; i < cameras.size() && !error; ++i) {
      std::filesystem::create_directories(options.keep / fmt::format("camera-{}", i), error);
    }
    if (error) {
      return failure(ErrorCode::kIo, "{}: cannot create: {}", options.keep.string(),
                     error.message());
    }
  }
  std::mutex mutex;  // Guards every Stream::latest, `lost` and `ended`.
  std::condition_variable arrived;
  std::optional<Error> lost;
  bool ended = false;

  LiveViews result;
  std::vector<std::unique_ptr<Stream>> streams;
  for (Camera* camera : cameras) {
    CameraSettings wanted;
    wanted.framesPerSecond = options.framesPerSecond;
    ASSIGN_OR_RETURN(const CameraSettings settings, camera->configure(wanted));
    if (!settings.region) {
      return failure(ErrorCode::kDevice, "camera {} does not tell its picture's size",
                     camera->info().address);
    }
    result.sizes.emplace_back(settings.region->width, settings.region->height);
    result.counts.push_back(0);
    streams.push_back(std::make_unique<Stream>(*camera));
    streams.back()->collector.emplace(settings.region->width);
  }
  for (const auto& stream : streams) {
    RETURN_IF_ERROR(stream->camera.start(
        [&mutex, &arrived, &stream = *stream](Frame&& frame) {
          {
            const std::lock_guard lock(mutex);
            stream.latest = std::move(frame);
          }
          arrived.notify_one();
        },
        [&](const Error& error) {
          {
            const std::lock_guard lock(mutex);
            if (error.code == ErrorCode::kCancelled)
              ended = true;
            else
              lost = error;
          }
          arrived.notify_one();
        }));
  }

  const TimePoint start = Clock::now();
  TimePoint lastFrame = start;
  const auto least = [&] { return *std::min_element(result.counts.begin(), result.counts.end()); };
  while (least() < options.wanted) {
    progress.update("views of the board", static_cast<std::size_t>(least()),
                    static_cast<std::size_t>(options.wanted));
    if (stop.stop_requested() || progress.cancelled()) {
      return failure(ErrorCode::kCancelled, "cancelled{}",
                     options.keep.empty() || result.sightings.empty()
                         ? std::string()
                         : fmt::format("; the {} pictures taken so far are in {}",
                                       result.sightings.size(), options.keep.string()));
    }
    if (toSeconds(Clock::now() - start) > options.timeLimitSeconds) break;

    // The latest frames of all cameras that have one.
    std::vector<Stream*> fresh;
    bool over = false;
    {
      std::unique_lock lock(mutex);
      const auto any = [&] {
        return lost || ended || std::any_of(streams.begin(), streams.end(), [](const auto& s) {
                 return s->latest.has_value();
               });
      };
      arrived.wait_for(lock, std::chrono::milliseconds(50), any);
      if (lost) return tl::unexpected<Error>(*lost);
      over = ended;
      for (const auto& stream : streams) {
        if (!stream->latest) continue;
        stream->shown = std::exchange(stream->latest, std::nullopt);
        fresh.push_back(stream.get());
      }
    }
    if (fresh.empty()) {
      if (over) break;
      if (toSeconds(Clock::now() - lastFrame) > kSilenceSeconds) {
        return failure(ErrorCode::kDevice, "no camera sent a frame for {} s", kSilenceSeconds);
      }
      continue;
    }
    lastFrame = Clock::now();
    std::vector<Result<BoardDetection>> found(fresh.size());
    oneapi::tbb::parallel_for(std::size_t{0}, fresh.size(), [&](std::size_t i) {
      found[i] = detectIn(*fresh[i]->shown, options.board);
    });
    for (std::size_t i = 0; i < fresh.size(); ++i) {
      if (!found[i]) return tl::unexpected<Error>(found[i].error());
      Stream& stream = *fresh[i];
      stream.shownTime = stream.shown->metadata.midExposure;
      stream.verdict = stream.collector->judge(found[i]->view, stream.shownTime);
      stream.corners = pixelsOf(found[i]->view);
      stream.view.reset();
      if (stream.verdict == ViewVerdict::kKeep || stream.verdict == ViewVerdict::kNotNew) {
        stream.view = std::move(found[i]->view);
      }
    }

    // A moment: new to one camera at least, still in all that see the board.
    const bool keep = std::any_of(fresh.begin(), fresh.end(),
                                  [](const Stream* s) { return s->verdict == ViewVerdict::kKeep; });
    const TimePoint now = fresh.front()->shownTime;
    const auto together = [&](const Stream& s) {
      return std::abs(toSeconds(s.shownTime - now)) < kTogetherSeconds;
    };
    const bool moving = std::any_of(streams.begin(), streams.end(), [&](const auto& s) {
      return together(*s) && s->verdict == ViewVerdict::kMoving;
    });
    if (keep && !moving) {
      BoardSighting sighting;
      sighting.name = fmt::format("view-{:03}", result.sightings.size());
      for (std::size_t i = 0; i < streams.size(); ++i) {
        Stream& stream = *streams[i];
        if (!together(stream) || !stream.view) {
          sighting.views.emplace_back();
          continue;
        }
        stream.view->name = sighting.name;
        if (!options.keep.empty()) {
          RETURN_IF_ERROR(keepPicture(*stream.shown, options.keep / fmt::format("camera-{}", i) /
                                                         (sighting.name + ".png")));
        }
        stream.collector->keep(*stream.view);
        auto corners = std::make_shared<std::vector<Eigen::Vector2d>>(*stream.kept);
        const auto added = pixelsOf(*stream.view);
        corners->insert(corners->end(), added.begin(), added.end());
        stream.kept = std::move(corners);
        ++result.counts[i];
        sighting.views.push_back(stream.view);
      }
      result.sightings.push_back(std::move(sighting));
    }
    if (onState) {
      LiveViewState state;
      state.counts = result.counts;
      state.wanted = options.wanted;
      state.sizes = result.sizes;
      for (const auto& stream : streams) {
        state.verdicts.push_back(stream->verdict);
        state.corners.push_back(stream->corners);
        state.kept.push_back(stream->kept);
      }
      onState(state);
    }
  }
  return result;
}

}  // namespace lightsketch
