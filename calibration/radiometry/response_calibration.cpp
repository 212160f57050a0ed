#include "calibration/radiometry/response_calibration.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>

#include "calibration/radiometry/response_fit.h"
#include "capture/frame/median.h"

namespace lightsketch {
namespace {

std::size_t index(int value) { return static_cast<std::size_t>(value); }

// A share of the places that only motion or changing light explains; what remains below it the
// solver's robust weights take care of.
constexpr double kMovedShare = 0.25;
// True times are adopted where they take this share of the residual away.
constexpr double kTimesGain = 0.15;
constexpr double kClippedShare = 1e-3;  // of samples at 0 that shows clipping

// A format's samples as counts, without looking the format up for every one.
class Reader {
 public:
  explicit Reader(const Frame& frame)
      : frame_(frame), info_(pixelFormatInfo(frame.format)), samples_(index(info_.channels)) {}
  double operator()(int x, int y, int sample) const {
    const std::size_t i = (index(y) * index(frame_.width) + index(x)) * samples_ + index(sample);
    return info_.bits <= 8 ? frame_.bytes[i] : frame_.bytes[2 * i] | (frame_.bytes[2 * i + 1] << 8);
  }

 private:
  const Frame& frame_;
  const PixelFormatInfo& info_;
  std::size_t samples_;
};

// Frames of one exposure time.
struct Group {
  double seconds;
  std::vector<const Frame*> frames;
};

// What all frames share.
struct Camera {
  const PixelFormatInfo* info = nullptr;
  int width = 0;
  int height = 0;
  double gainDb = 0;
  int colours = 1;
  double maxCount = 255;
  double saturation = 255;

  int pitch() const { return info->isBayer ? 2 : 1; }  // to the next sample of the same colour
  int samples() const { return info->channels; }       // per pixel
};

// Every `step`-th pixel of rows and columns; odd steps visit all sites of a Bayer cell.
template <class Body>
void forEachSample(const Camera& camera, int step, Body body) {
  for (int y = 0; y < camera.height; y += step) {
    for (int x = 0; x < camera.width; x += step) {
      for (int s = 0; s < camera.samples(); ++s) {
        body(x, y, s, sampleColour(*camera.info, x, y, s));
      }
    }
  }
}

int stepFor(const Camera& camera, double pixels) {
  const double all = static_cast<double>(camera.width) * camera.height;
  const int step = static_cast<int>(std::max(1.0, std::sqrt(all / pixels)));
  return step % 2 == 0 ? step - 1 : step;
}

// --- Reading the input ---------------------------------------------------------------------------

Result<void> checkAgainst(const Camera& camera, const Frame& frame, std::string_view what,
                          std::size_t number) {
  if (frame.format != camera.info->format || frame.width != camera.width ||
      frame.height != camera.height) {
    return failure(ErrorCode::kInvalidArgument,
                   "{} {}: {} x {} {}, but the first frame is {} x {} {}; all frames must come "
                   "from one camera with one setting",
                   what, number + 1, frame.width, frame.height, pixelFormatInfo(frame.format).name,
                   camera.width, camera.height, camera.info->name);
  }
  const std::size_t bytes =
      index(frame.width) * index(frame.height) * index(camera.info->bytesPerPixel);
  if (frame.bytes.size() != bytes) {
    return failure(ErrorCode::kCorrupt, "{} {}: {} bytes instead of {}", what, number + 1,
                   frame.bytes.size(), bytes);
  }
  if (std::abs(frame.metadata.gainDb - camera.gainDb) > 0.01) {
    return failure(ErrorCode::kInvalidArgument,
                   "{} {}: gain {} dB, but the first frame has {} dB; keep the gain and change the "
                   "exposure time only",
                   what, number + 1, frame.metadata.gainDb, camera.gainDb);
  }
  return {};
}

// Shortest first.
Result<std::vector<Group>> groupByExposure(const Camera& camera, std::span<const Frame> frames) {
  std::vector<Group> groups;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Frame& frame = frames[i];
    RETURN_IF_ERROR(checkAgainst(camera, frame, "frame", i));
    const double seconds = frame.metadata.exposureSeconds;
    if (!(seconds > 0)) {
      return failure(ErrorCode::kInvalidArgument,
                     "frame {}: its exposure time is unknown; give the times in seconds", i + 1);
    }
    const auto same = std::ranges::find_if(groups, [seconds](const Group& group) {
      return std::abs(group.seconds / seconds - 1) < 1e-3;
    });
    if (same != groups.end()) {
      same->frames.push_back(&frame);
    } else {
      groups.push_back({seconds, {&frame}});
    }
  }
  if (groups.size() < 2) {
    return failure(ErrorCode::kInvalidArgument,
                   "the bracket has one exposure time only ({} s); a response needs at least two, "
                   "better six, each twice the one before",
                   groups.empty() ? 0.0 : groups[0].seconds);
  }
  std::ranges::sort(groups, {}, &Group::seconds);
  return groups;
}

// Some sensors stop short of their format's range: then one count below its top holds a heap of
// samples, and none lies above.
double saturationCount(const Camera& camera, const std::vector<std::vector<Group>>& brackets) {
  std::vector<std::size_t> histogram(index(static_cast<int>(camera.maxCount)) + 1);
  std::size_t total = 0;
  for (const auto& groups : brackets) {
    const Reader read(*groups.back().frames[0]);
    forEachSample(camera, stepFor(camera, 400'000), [&](int x, int y, int s, int) {
      ++histogram[static_cast<std::size_t>(read(x, y, s))];
      ++total;
    });
  }
  std::size_t top = histogram.size() - 1;
  while (top > 0 && histogram[top] == 0) --top;
  const std::size_t below = top > 1 ? std::max(histogram[top - 1], histogram[top - 2]) : 0;
  const bool heap = histogram[top] > total / 1000 && histogram[top] > 5 * below;
  return heap && top > 0 ? static_cast<double>(top) : camera.maxCount;
}

Result<void> checkExposed(const Camera& camera, const std::vector<Group>& groups) {
  const auto share = [&](const Frame& frame, auto&& test) {
    const Reader read(frame);
    double hits = 0, total = 0;
    forEachSample(camera, stepFor(camera, 40'000), [&](int x, int y, int s, int) {
      hits += test(read(x, y, s));
      ++total;
    });
    return hits / total;
  };
  if (share(*groups.front().frames[0],
            [&](double count) { return count >= camera.saturation - 0.5; }) > 0.99) {
    return failure(ErrorCode::kInvalidArgument,
                   "even the shortest exposure ({} s) is saturated everywhere; take shorter "
                   "exposures or less light",
                   groups.front().seconds);
  }
  // Black: nothing of the longest exposure stands out from the shortest.
  const Reader shortest(*groups.front().frames[0]);
  const Reader longest(*groups.back().frames[0]);
  double rise = 0, total = 0;
  forEachSample(camera, stepFor(camera, 40'000), [&](int x, int y, int s, int) {
    rise += longest(x, y, s) - shortest(x, y, s) > 0.05 * camera.maxCount;
    ++total;
  });
  if (rise / total < 1e-3) {
    return failure(ErrorCode::kInvalidArgument,
                   "the longest exposure ({} s) is as dark as the shortest ({} s); take longer "
                   "exposures, take the lens cap off, or give the true exposure times",
                   groups.back().seconds, groups.front().seconds);
  }
  return {};
}

// --- Darkness ------------------------------------------------------------------------------------

struct Darkness {
  Image<float> mean;
  std::vector<ResponseSamples::Black> black;  // per colour, counts
  std::vector<double> variance;  // of one frame, counts^2, from the first two; hot pixels aside
  std::vector<double> pairs;     // of samples that it was measured from
  std::vector<PixelPosition> hotPixels;
};

Darkness measureDarkness(const Camera& camera, std::span<const Frame> frames,
                         double hotPixelSigmas) {
  Darkness dark;
  const std::size_t n = frames.size();
  dark.mean = Image<float>(camera.width, camera.height, camera.samples());
  for (const Frame& frame : frames) {
    const Reader read(frame);
    forEachSample(camera, 1, [&](int x, int y, int s, int) {
      dark.mean(x, y, s) += static_cast<float>(read(x, y, s) / static_cast<double>(n));
    });
  }
  std::vector<std::vector<double>> means(index(camera.colours));
  std::vector<double> zeros(index(camera.colours));
  const Reader first(frames[0]);
  const Reader second(frames[n > 1 ? 1 : 0]);
  forEachSample(camera, 1, [&](int x, int y, int s, int colour) {
    const std::size_t c = index(colour);
    means[c].push_back(static_cast<double>(dark.mean(x, y, s)));
    zeros[c] += first(x, y, s) == 0;
  });
  std::vector<double> centre, scatter;
  for (std::size_t c = 0; c < means.size(); ++c) {
    std::vector<double> copy = means[c];
    centre.push_back(median(copy));
    for (double& value : copy) value = std::abs(value - centre[c]);
    // Means of whole counts repeat: their scatter is at least that of the rounding.
    scatter.push_back(std::max(1.4826 * median(copy), 0.3 / std::sqrt(static_cast<double>(n))));
    const double limit = centre[c] + hotPixelSigmas * scatter[c];
    double sum = 0, count = 0;
    for (const double value : means[c]) {
      if (value > limit) continue;
      sum += value;
      ++count;
    }
    // The standard error over many pixels is tiny; what limits it is the drift between frames.
    dark.black.push_back({sum / count, std::max(scatter[c] / std::sqrt(count), 0.02),
                          zeros[c] > kClippedShare * static_cast<double>(means[c].size())});
  }
  dark.variance.assign(means.size(), 0);
  dark.pairs.assign(means.size(), 0);
  forEachSample(camera, 1, [&](int x, int y, int s, int colour) {
    const std::size_t c = index(colour);
    if (static_cast<double>(dark.mean(x, y, s)) <= centre[c] + hotPixelSigmas * scatter[c]) {
      if (n < 2) return;
      dark.variance[c] += std::pow(first(x, y, s) - second(x, y, s), 2) / 2;
      ++dark.pairs[c];
      return;
    }
    const PixelPosition pixel{x, y};
    if (dark.hotPixels.empty() || dark.hotPixels.back() != pixel) dark.hotPixels.push_back(pixel);
  });
  for (std::size_t c = 0; c < means.size(); ++c) dark.variance[c] /= std::max(dark.pairs[c], 1.0);
  return dark;
}

// Without dark frames: what the places that are darkest at the longest exposures show at the two
// shortest. Where both agree, no light arrives there any more; otherwise black lies somewhere
// below, which the fit will find.
std::vector<ResponseSamples::Black> guessBlack(const Camera& camera,
                                               const std::vector<Group>& groups) {
  struct Trace {
    double longest, shortest, second;
  };
  std::vector<std::vector<Trace>> traces(index(camera.colours));
  const Reader longest(*groups.back().frames[0]);
  const Reader shortest(*groups[0].frames[0]);
  const Reader second(*groups[1].frames[0]);
  forEachSample(camera, stepFor(camera, 200'000), [&](int x, int y, int s, int colour) {
    const Trace trace{longest(x, y, s), shortest(x, y, s), second(x, y, s)};
    if (trace.longest >= trace.shortest) traces[index(colour)].push_back(trace);
  });
  std::vector<ResponseSamples::Black> black;
  for (auto& list : traces) {
    // Noise cut off at 0 leaves its upper half standing; a heap of zeros alone is a painted border.
    const auto zeros = static_cast<double>(std::ranges::count(list, 0.0, &Trace::shortest));
    const auto ones = static_cast<double>(std::ranges::count(list, 1.0, &Trace::shortest));
    const bool clipped =
        zeros > kClippedShare * static_cast<double>(list.size()) && ones > 0.02 * zeros;
    std::ranges::sort(list, {}, &Trace::longest);
    std::vector<double> first, next;
    for (std::size_t i = 0; i < list.size() / 20; ++i) {
      first.push_back(list[i].shortest);
      next.push_back(list[i].second);
    }
    const double level = median(first);
    const double fine = std::max(1.0, 0.002 * camera.maxCount);
    const double coarse = 0.03 * camera.maxCount;
    if (clipped) {
      black.push_back({0, fine, true});
    } else if (std::abs(median(next) - level) <= fine) {
      black.push_back({level, fine, false});
    } else {
      black.push_back({std::min(level, coarse), coarse, false});
    }
  }
  return black;
}

// --- The curve -----------------------------------------------------------------------------------

// Places with as little detail as possible around them, evenly over what the bracket saw from dark
// to bright: detail turns the least motion into error.
// Places that grow darker with more exposure are left out; returns how many of all did.
struct Visited {
  std::size_t places = 0;
  std::size_t contradictory = 0;
};
Visited addPlaces(const Camera& camera, const std::vector<Group>& groups, int bracket,
                  const std::vector<PixelPosition>& hotPixels, int placesPerColour,
                  ResponseSamples& samples) {
  struct Candidate {
    int x, y, s;
    double level;
    double contrast;
  };
  constexpr int kLevels = 100;
  constexpr double kFall = 0.08;  // of full scale; no noise of a working camera reaches that
  Visited visited;
  std::vector<Reader> readers;
  for (const Group& group : groups) readers.emplace_back(*group.frames[0]);
  std::vector<std::vector<Candidate>> candidates(index(camera.colours));
  const int pitch = camera.pitch();
  forEachSample(camera, stepFor(camera, 60'000), [&](int x, int y, int s, int colour) {
    if (x < pitch || y < pitch || x >= camera.width - pitch || y >= camera.height - pitch) return;
    Candidate candidate{x, y, s, 0, 0};
    int usable = 0;
    double nearest = 1, darkest = 1, brightest = 0, fall = 0;
    std::size_t middle = 0;
    for (std::size_t j = 0; j < readers.size(); ++j) {
      const double value = readers[j](x, y, s) / camera.saturation;
      candidate.level += value;
      darkest = std::min(darkest, value);
      brightest = std::max(brightest, value);
      fall = std::max(fall, brightest - value);
      usable += value > 0.02 && value < 0.97;
      if (std::abs(value - 0.5) < nearest) {
        nearest = std::abs(value - 0.5);
        middle = j;
      }
    }
    // What no exposure changes is no picture but a frame around one.
    if (usable < 2 || brightest - darkest < 0.05) return;
    ++visited.places;
    if (fall > kFall) {
      ++visited.contradictory;
      return;
    }
    const Reader& read = readers[middle];
    double low = read(x, y, s), high = low;
    for (const auto& [dx, dy] : {std::pair{pitch, 0}, {-pitch, 0}, {0, pitch}, {0, -pitch}}) {
      const double value = read(x + dx, y + dy, s);
      low = std::min(low, value);
      high = std::max(high, value);
    }
    candidate.contrast = high - low;
    candidates[index(colour)].push_back(candidate);
  });
  for (int colour = 0; colour < camera.colours; ++colour) {
    auto& list = candidates[index(colour)];
    std::erase_if(list, [&](const Candidate& c) {
      return std::ranges::find(hotPixels, PixelPosition{c.x, c.y}) != hotPixels.end();
    });
    std::ranges::sort(list, {}, &Candidate::contrast);
    double low = std::numeric_limits<double>::infinity(), high = 0;
    for (const Candidate& c : list) {
      low = std::min(low, c.level);
      high = std::max(high, c.level);
    }
    std::vector<int> taken(kLevels, 0);
    for (const Candidate& c : list) {
      const auto level = std::min<std::size_t>(
          static_cast<std::size_t>((c.level - low) / std::max(high - low, 1e-9) * kLevels),
          kLevels - 1);
      if (++taken[level] > std::max(1, placesPerColour / kLevels)) continue;
      ResponseSamples::Place place{colour, bracket, {}};
      for (const Group& group : groups) {
        double sum = 0;
        for (const Frame* frame : group.frames) sum += Reader(*frame)(c.x, c.y, c.s);
        place.values.push_back(sum / static_cast<double>(group.frames.size()) / camera.maxCount);
      }
      samples.places.push_back(std::move(place));
    }
  }
  return visited;
}

// Largest distance from the best straight line over the values reached, as a fraction of full
// scale.
double deviationFromLine(const ResponseFit::Curve& curve) {
  constexpr int kSteps = 200;
  const double low = std::max(curve.lowest, curve.black);
  const double width = (curve.highest - low) / kSteps;
  if (!(width > 0)) return 0;
  double sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (int i = 0; i <= kSteps; ++i) {
    const double x = low + i * width;
    const double y = curve.exposureAt(x);
    sx += x;
    sy += y;
    sxx += x * x;
    sxy += x * y;
  }
  constexpr double n = kSteps + 1;
  const double slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
  double largest = 0;
  for (int i = 0; i <= kSteps; ++i) {
    const double x = low + i * width;
    largest = std::max(largest, std::abs(curve.exposureAt(x) - (sy / n + slope * (x - sx / n))));
  }
  return largest;
}

// Whether a line explains the samples as well as the curve, whose further parameters take some of
// any noise with them (the F test of nested models). Where the brightest samples end short of
// saturation the curve is free to bend, which is no sign of a bend.
bool isAsGood(const ResponseFit& line, const ResponseFit& curve) {
  const auto misfit = [&](const ResponseFit& fit) {
    double sum = 0;
    for (const auto& r : fit.residuals) {
      sum += std::min(std::pow(r.error / curve.noiseSigma(r.colour, r.value), 2), 25.0);
    }
    return sum / static_cast<double>(fit.residuals.size());
  };
  const auto further = static_cast<double>(curve.curves.size()) * (ResponseFit::kKnots - 1);
  const double byChance =
      (further + 4 * std::sqrt(2 * further)) / static_cast<double>(curve.residuals.size());
  return misfit(line) <= (1 + byChance) * misfit(curve);
}

Result<ResponseCurve> curveOf(const ResponseFit& fit, const Camera& camera, bool linear) {
  if (linear) {
    std::vector<double> black;
    for (const auto& curve : fit.curves) black.push_back(curve.black * camera.maxCount);
    return ResponseCurve::linear(black, camera.maxCount, camera.saturation);
  }
  // A node per count of 8 bits; 1025 resolve finer formats to 1e-5.
  const int nodes = std::min(static_cast<int>(camera.maxCount) + 1, 1025);
  std::vector<std::vector<double>> tables;
  for (const auto& curve : fit.curves) {
    std::vector<double>& table = tables.emplace_back();
    for (int i = 0; i < nodes; ++i) {
      table.push_back(curve.exposureAt(static_cast<double>(i) / (nodes - 1)));
    }
  }
  return ResponseCurve::tabulated(std::move(tables), camera.maxCount, camera.saturation);
}

// --- Noise ---------------------------------------------------------------------------------------

struct TransferPoint {
  double exposure;
  double variance;  // of the exposure, rounding's taken off
  double weight;    // degrees of freedom
};

// Variance against mean from differences of two frames of one exposure, which what is fixed in the
// picture leaves alone (Janesick 2007, chapter 5).
std::vector<std::vector<TransferPoint>> photonTransfer(
    const Camera& camera, const ResponseCurve& response,
    const std::vector<std::vector<Group>>& brackets, const std::vector<bool>& clipped) {
  constexpr std::size_t kBins = 48;
  constexpr double kFewest = 100;
  struct Bin {
    double n = 0, mean = 0, d = 0, dd = 0;
  };
  using Bins = std::array<Bin, kBins>;
  std::vector<Bins> all(index(camera.colours));
  for (const auto& groups : brackets) {
    for (const Group& group : groups) {
      for (std::size_t k = 0; k + 1 < group.frames.size(); k += 2) {
        const Reader a(*group.frames[k]);
        const Reader b(*group.frames[k + 1]);
        std::vector<Bins> bins(index(camera.colours));
        forEachSample(camera, stepFor(camera, 500'000), [&](int x, int y, int s, int colour) {
          const double mean = 0.5 * (a(x, y, s) + b(x, y, s));
          const double d = a(x, y, s) - b(x, y, s);
          Bin& bin = bins[index(colour)][std::min(
              static_cast<std::size_t>(std::sqrt(mean / camera.maxCount) * kBins), kBins - 1)];
          bin.n += 1;
          bin.mean += mean;
          bin.d += d;
          bin.dd += d * d;
        });
        for (std::size_t c = 0; c < bins.size(); ++c) {
          for (std::size_t i = 0; i < kBins; ++i) {
            const Bin& bin = bins[c][i];
            if (bin.n < 2) continue;
            // The light may flicker between the two: the bin's mean difference is not noise.
            all[c][i].n += bin.n - 1;
            all[c][i].mean += bin.mean / bin.n * (bin.n - 1);
            all[c][i].dd += bin.dd - bin.d * bin.d / bin.n;
          }
        }
      }
    }
  }
  std::vector<std::vector<TransferPoint>> points(index(camera.colours));
  for (int colour = 0; colour < camera.colours; ++colour) {
    for (std::size_t i = 0; i < kBins; ++i) {
      const Bin& bin = all[index(colour)][i];
      if (bin.n < kFewest) continue;
      const double mean = bin.mean / bin.n;
      const double variance = 0.5 * bin.dd / bin.n;
      // Clear of the clipping levels with the whole bin, not only with its mean.
      const double reach = 4 * std::sqrt(variance) + 1;
      const double upper = std::pow(static_cast<double>(i + 1) / kBins, 2) * camera.maxCount;
      const double lower = std::pow(static_cast<double>(i) / kBins, 2) * camera.maxCount;
      if (upper + reach > camera.saturation || (clipped[index(colour)] && lower < reach)) continue;
      const double slope = response.slope(mean, colour);
      points[index(colour)].push_back(
          {response.exposure(mean, colour), (variance - 1.0 / 12) * slope * slope, bin.n});
    }
  }
  return points;
}

struct NoiseFit {
  ChannelNoise noise;
  double electronsSigma;
  double readSigma;
};

// variance = exposure / electrons + (read / electrons)^2, weighted by the scatter of a variance,
// 2 / n of its square; twice, the second time with the first fit's variances as weights.
std::optional<NoiseFit> fitNoise(const std::vector<TransferPoint>& points) {
  if (points.size() < 3) return std::nullopt;
  Eigen::Vector2d model = Eigen::Vector2d::Zero();  // slope, constant
  Eigen::Matrix2d covariance;
  for (int pass = 0; pass < 3; ++pass) {
    Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
    Eigen::Vector2d right = Eigen::Vector2d::Zero();
    for (const TransferPoint& p : points) {
      const double expected = pass == 0 ? p.variance : model[0] * p.exposure + model[1];
      const double weight = p.weight / (2 * std::max(expected * expected, 1e-16));
      const Eigen::Vector2d row(p.exposure, 1);
      normal += weight * row * row.transpose();
      right += weight * p.variance * row;
    }
    covariance = normal.inverse();
    model = covariance * right;
    // Read noise below what rounding hides comes out as nothing.
    if (model[1] < 0) model = {right[0] / normal(0, 0), 0};
  }
  if (!(model[0] > 0) || !covariance.allFinite()) return std::nullopt;
  double misfit = 0;
  for (const TransferPoint& p : points) {
    const double expected = model[0] * p.exposure + model[1];
    misfit += p.weight / 2 * std::pow(p.variance / expected - 1, 2);
  }
  // Where the straight line does not hold to the points' own scatter, the sigmas say so.
  covariance *= std::max(1.0, misfit / static_cast<double>(points.size() - 2));
  const double electrons = 1 / model[0];
  const double read = std::sqrt(model[1]) * electrons;
  const double constantSigma = std::sqrt(covariance(1, 1));
  return NoiseFit{{electrons, read},
                  electrons * electrons * std::sqrt(covariance(0, 0)),
                  read > 0 ? electrons * constantSigma / (2 * std::sqrt(model[1]))
                           : electrons * std::sqrt(constantSigma)};
}

// --- Flat field ----------------------------------------------------------------------------------

struct Flat {
  FlatField field;
  std::vector<double> sigma;  // of a node, per colour
};

// Least squares for the nodes of a bilinear grid, with just enough smoothness that nodes without
// samples are defined.
Result<Flat> measureFlat(const Camera& camera, const SensorModel& sensor,
                         std::span<const Frame> frames, int columns) {
  const int rows = std::clamp(static_cast<int>(std::lround(static_cast<double>(columns - 1) *
                                                           camera.height / camera.width)) +
                                  1,
                              2, 4 * columns);
  const int nodes = columns * rows;
  const int step = stepFor(camera, 300'000);
  std::vector<PixelPosition> hot = sensor.hotPixels;
  const auto before = [](const PixelPosition& a, const PixelPosition& b) {
    return std::pair(a.y, a.x) < std::pair(b.y, b.x);
  };
  std::ranges::sort(hot, before);
  std::vector<Reader> readers;
  for (const Frame& frame : frames) readers.emplace_back(frame);
  std::vector<double> values;
  std::vector<double> sigmas;
  for (int colour = 0; colour < camera.colours; ++colour) {
    std::vector<Eigen::Triplet<double>> entries;
    Eigen::VectorXd right = Eigen::VectorXd::Zero(nodes);
    double sum = 0, squares = 0, count = 0, saturated = 0;
    const auto visit = [&](auto&& body) {
      forEachSample(camera, step, [&](int x, int y, int s, int c) {
        if (c != colour || std::binary_search(hot.begin(), hot.end(), PixelPosition{x, y}, before))
          return;
        double counts = 0;
        for (const Reader& read : readers) counts += read(x, y, s);
        counts /= static_cast<double>(readers.size());
        double exposure = sensor.response.exposure(counts, colour);
        if (!sensor.darkCounts.empty() && sensor.response.isLinear()) {
          exposure = sensor.response.slope(counts, colour) *
                     (counts - static_cast<double>(sensor.darkCounts(x, y, s)));
        }
        const double u = (x + 0.5) / camera.width * (columns - 1);
        const double v = (y + 0.5) / camera.height * (rows - 1);
        const int i = std::min(static_cast<int>(u), columns - 2);
        const int j = std::min(static_cast<int>(v), rows - 2);
        const double fu = u - i, fv = v - j;
        const std::array<double, 4> weight{(1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv,
                                           fu * fv};
        const std::array<int, 4> node{j * columns + i, j * columns + i + 1, (j + 1) * columns + i,
                                      (j + 1) * columns + i + 1};
        body(exposure, counts, node, weight);
      });
    };
    Eigen::MatrixXd diagonalBand = Eigen::MatrixXd::Zero(nodes, 9);  // the 3 x 3 neighbours
    visit([&](double exposure, double counts, const auto& node, const auto& weight) {
      saturated += counts >= camera.saturation - 0.5;
      sum += exposure;
      squares += exposure * exposure;
      ++count;
      for (std::size_t a = 0; a < 4; ++a) {
        right[node[a]] += weight[a] * exposure;
        for (std::size_t b = 0; b < 4; ++b) {
          const int dj = node[b] / columns - node[a] / columns;
          const int di = node[b] % columns - node[a] % columns;
          diagonalBand(node[a], 3 * (dj + 1) + di + 1) += weight[a] * weight[b];
        }
      }
    });
    const double mean = sum / count;
    if (saturated > 0.001 * count || mean < 0.05) {
      return failure(ErrorCode::kInvalidArgument,
                     "the flat-field frames are {}; expose the diffuser to about two thirds of "
                     "full scale",
                     mean < 0.05 ? "too dark" : "saturated");
    }
    for (int n = 0; n < nodes; ++n) {
      for (int dj = -1; dj <= 1; ++dj) {
        for (int di = -1; di <= 1; ++di) {
          const double entry = diagonalBand(n, 3 * (dj + 1) + di + 1);
          if (entry != 0) entries.emplace_back(n, n + dj * columns + di, entry);
        }
      }
    }
    const double smoothness = 0.01 * count / nodes;
    const auto bend = [&](int a, int b, int c) {
      const std::array<int, 3> node{a, b, c};
      constexpr std::array<double, 3> kSecond{1, -2, 1};
      for (std::size_t p = 0; p < 3; ++p) {
        for (std::size_t q = 0; q < 3; ++q) {
          entries.emplace_back(node[p], node[q], smoothness * kSecond[p] * kSecond[q]);
        }
      }
    };
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i) {
        const int n = j * columns + i;
        if (i > 0 && i + 1 < columns) bend(n - 1, n, n + 1);
        if (j > 0 && j + 1 < rows) bend(n - columns, n, n + columns);
      }
    }
    Eigen::SparseMatrix<double> normal(nodes, nodes);
    normal.setFromTriplets(entries.begin(), entries.end());
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(normal);
    const Eigen::VectorXd solution = factor.solve(right);
    double residual = 0;
    visit([&](double exposure, double, const auto& node, const auto& weight) {
      double model = 0;
      for (std::size_t a = 0; a < 4; ++a) model += weight[a] * solution[node[a]];
      residual += std::pow(exposure - model, 2);
    });
    values.insert(values.end(), solution.begin(), solution.end());
    sigmas.push_back(std::sqrt(residual / count) / mean * std::sqrt(nodes / count));
  }
  ASSIGN_OR_RETURN(auto field, FlatField::create(columns, rows, camera.colours, std::move(values)));
  return Flat{std::move(field), std::move(sigmas)};
}

std::vector<std::string> colourNames(int colours) {
  if (colours == 1) return {"grey"};
  return {"red", "green", "blue"};
}

}  // namespace

Result<void> ResponseOptions::validate() const {
  if (!(linearTolerance >= 0 && linearTolerance < 1) || placesPerColour < 100 ||
      placesPerColour > 100'000 || !(hotPixelSigmas > 0) || flatColumns < 2 || flatColumns > 200) {
    return failure(ErrorCode::kInvalidArgument,
                   "response options: linear tolerance 0..1, 100 to 100000 places, hot pixels over "
                   "0 sigma, 2 to 200 columns of the flat field");
  }
  return {};
}

Result<ResponseCalibration> calibrateResponse(const ResponseInput& input,
                                              const ResponseOptions& options, Progress* progress) {
  SilentProgress silent;
  Progress& report = progress ? *progress : silent;
  RETURN_IF_ERROR(options.validate());
  if (input.brackets.empty() || input.brackets[0].empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "no bracket was given; a response needs pictures "
                   "of a still scene at several exposure times");
  }
  const Frame& first = input.brackets[0][0];
  Camera camera;
  camera.info = &pixelFormatInfo(first.format);
  camera.width = first.width;
  camera.height = first.height;
  camera.gainDb = first.metadata.gainDb;
  camera.colours = colourChannels(first.format);
  camera.maxCount = (1 << camera.info->bits) - 1;
  if (camera.width < 16 || camera.height < 16) {
    return failure(ErrorCode::kInvalidArgument, "frames of {} x {} pixels are too small",
                   camera.width, camera.height);
  }
  constexpr std::size_t kStages = 4;
  const auto stage = [&](std::size_t done) -> Result<void> {
    report.update("calibrating the response", done, kStages);
    if (report.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    return {};
  };
  RETURN_IF_ERROR(stage(0));
  std::vector<std::vector<Group>> brackets;
  for (const auto& frames : input.brackets) {
    ASSIGN_OR_RETURN(brackets.emplace_back(), groupByExposure(camera, frames));
  }
  for (std::size_t i = 0; i < input.darkFrames.size(); ++i) {
    RETURN_IF_ERROR(checkAgainst(camera, input.darkFrames[i], "dark frame", i));
  }
  for (std::size_t i = 0; i < input.flatFrames.size(); ++i) {
    RETURN_IF_ERROR(checkAgainst(camera, input.flatFrames[i], "flat-field frame", i));
  }
  camera.saturation = saturationCount(camera, brackets);
  for (const auto& groups : brackets) RETURN_IF_ERROR(checkExposed(camera, groups));

  ResponseCalibration result;
  SensorModel& sensor = result.sensor;
  ResponseSummary& summary = result.summary;
  sensor.format = first.format;
  sensor.width = camera.width;
  sensor.height = camera.height;
  summary.darkFrames = static_cast<int>(input.darkFrames.size());
  summary.flatFrames = static_cast<int>(input.flatFrames.size());

  // Darkness.
  ResponseSamples samples;
  std::optional<Darkness> dark;
  std::vector<ResponseSamples::Black> black = guessBlack(camera, brackets[0]);
  if (!input.darkFrames.empty()) {
    dark = measureDarkness(camera, input.darkFrames, options.hotPixelSigmas);
    sensor.hotPixels = dark->hotPixels;
    for (std::size_t c = 0; c < black.size(); ++c) {
      // A mean that clipping has lifted says little about where black is.
      if (!dark->black[c].clipped)
        black[c] = dark->black[c];
      else
        black[c].clipped = true;
    }
  }
  RETURN_IF_ERROR(stage(1));

  // The curve, with the exposure times as given and as found, and whether a line does as well.
  samples.colours = camera.colours;
  samples.step = 1 / camera.maxCount;
  samples.saturation = camera.saturation / camera.maxCount;
  std::vector<bool> clipped;
  for (auto b : black) {
    clipped.push_back(b.clipped);
    b.value /= camera.maxCount;
    b.sigma /= camera.maxCount;
    samples.black.push_back(b);
  }
  Visited visited;
  for (std::size_t b = 0; b < brackets.size(); ++b) {
    auto& exposures = samples.exposures.emplace_back();
    for (const Group& group : brackets[b]) {
      exposures.push_back({group.seconds, static_cast<int>(group.frames.size())});
    }
    const Visited here = addPlaces(camera, brackets[b], static_cast<int>(b), sensor.hotPixels,
                                   options.placesPerColour, samples);
    visited.places += here.places;
    visited.contradictory += here.contradictory;
  }
  const double contradictory = static_cast<double>(visited.contradictory) /
                               std::max(1.0, static_cast<double>(visited.places));
  const auto checkStill = [](double share) -> Result<void> {
    if (share <= kMovedShare) return {};
    return failure(ErrorCode::kInvalidArgument,
                   "{:.0f} % of the places looked at contradict themselves between the exposures: "
                   "the scene, the camera or the light moved, or the times are wrong; fix them and "
                   "take the bracket again",
                   100 * share);
  };
  RETURN_IF_ERROR(checkStill(contradictory));
  ASSIGN_OR_RETURN(ResponseFit fit, fitResponse(samples, {}));
  ASSIGN_OR_RETURN(ResponseFit timed, fitResponse(samples, {.estimateTimes = true}));
  // Two exposures leave nothing to tell a wrong time from the curve.
  summary.timesEstimated = brackets[0].size() > 2 && timed.spread < (1 - kTimesGain) * fit.spread;
  if (summary.timesEstimated) std::swap(fit, timed);
  summary.disagreeing = contradictory + (1 - contradictory) * fit.disagreeing;
  RETURN_IF_ERROR(checkStill(summary.disagreeing));
  // A curve between a few levels only would be made of the smoothness prior.
  constexpr std::size_t kLevels = 20;
  std::vector<std::array<bool, kLevels>> seen(index(camera.colours), std::array<bool, kLevels>{});
  for (const auto& r : fit.residuals) {
    const double level = std::clamp(r.value / samples.saturation, 0.0, 1.0) * kLevels;
    seen[index(r.colour)][std::min(static_cast<std::size_t>(level), kLevels - 1)] = true;
  }
  for (std::size_t c = 0; c < seen.size(); ++c) {
    const auto levels = std::ranges::count(seen[c], true);
    if (levels < static_cast<std::ptrdiff_t>(kLevels / 2)) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: the bracket shows too few levels ({} of {} steps between dark and "
                     "saturated); take a scene with everything from dark to bright, exposures a "
                     "factor of 2 apart",
                     colourNames(camera.colours)[c], levels, kLevels);
    }
  }
  summary.linear = true;
  for (int c = 0; c < camera.colours; ++c) {
    auto& colour = summary.colours.emplace_back();
    colour.name = colourNames(camera.colours)[index(c)];
    colour.linearDeviation = deviationFromLine(fit.curves[index(c)]);
    summary.linear = summary.linear && colour.linearDeviation <= options.linearTolerance;
  }
  // No line at all goes through what a strongly bent response saw.
  Result<ResponseFit> line =
      fitResponse(samples, {.linear = true, .estimateTimes = summary.timesEstimated});
  summary.linear = line && (summary.linear || isAsGood(*line, fit));
  if (summary.linear) fit = std::move(*line);
  ASSIGN_OR_RETURN(sensor.response, curveOf(fit, camera, summary.linear));
  summary.places = static_cast<int>(samples.places.size());
  for (int c = 0; c < camera.colours; ++c) {
    auto& colour = summary.colours[index(c)];
    const ResponseFit::Curve& curve = fit.curves[index(c)];
    colour.blackCount = curve.black * camera.maxCount;
    colour.blackSigma = curve.blackSigma * camera.maxCount;
    colour.blackClipped = clipped[index(c)];
    colour.lowestCount = curve.lowest * camera.maxCount;
    colour.highestCount = curve.highest * camera.maxCount;
    double squares = 0, count = 0;
    for (const auto& residual : fit.residuals) {
      if (residual.colour != c) continue;
      squares += residual.error * residual.error;
      ++count;
    }
    colour.residual = camera.maxCount * std::sqrt(squares / std::max(count, 1.0));
    std::vector<double> sigmas;
    for (int m = 0; m < ResponseFit::kNodes; ++m) {
      const double value = curve.nodeValue(m);
      if (value >= curve.lowest && value <= curve.highest &&
          curve.exposure[index(m)] > ResponseFit::kDarkest) {
        sigmas.push_back(curve.logSigma[index(m)]);
      }
    }
    colour.curveSigma = median(sigmas);
  }
  const std::size_t stride = fit.residuals.size() / 6000 + 1;
  for (std::size_t i = 0; i < fit.residuals.size(); i += stride) {
    const auto& r = fit.residuals[i];
    summary.residuals.push_back({r.colour, r.value * camera.maxCount, r.error * camera.maxCount});
  }
  for (std::size_t b = 0; b < brackets.size(); ++b) {
    for (std::size_t j = 0; j < brackets[b].size(); ++j) {
      summary.exposures.push_back({static_cast<int>(b), brackets[b][j].seconds,
                                   static_cast<int>(brackets[b][j].frames.size()),
                                   std::expm1(fit.timeErrors[b][j])});
    }
  }
  RETURN_IF_ERROR(stage(2));

  // Noise.
  auto transfer = photonTransfer(camera, sensor.response, brackets, clipped);
  summary.noiseFromPairs =
      std::ranges::all_of(transfer, [](const auto& t) { return t.size() > 2; });
  sensor.noise.gainDb = camera.gainDb;
  sensor.noise.channels.clear();
  for (int c = 0; c < camera.colours; ++c) {
    auto& points = transfer[index(c)];
    if (!summary.noiseFromPairs) {
      points.clear();
      for (int bin = 0; bin < ResponseFit::kNoiseBins; ++bin) {
        const double value = std::pow((bin + 0.5) / ResponseFit::kNoiseBins, 2);
        if (value < fit.curves[index(c)].lowest || value > fit.curves[index(c)].highest) continue;
        const double counts = value * camera.maxCount;
        const double slope = sensor.response.slope(counts, c);
        const double sigma = fit.noiseSigma(c, value) * camera.maxCount;
        points.push_back(
            {sensor.response.exposure(counts, c), (sigma * sigma - 1.0 / 12) * slope * slope, 100});
      }
    } else if (dark && !clipped[index(c)] && dark->pairs[index(c)] > 0) {
      const double slope = sensor.response.slope(black[index(c)].value, c);
      points.push_back(
          {0, (dark->variance[index(c)] - 1.0 / 12) * slope * slope, dark->pairs[index(c)]});
    }
    const auto noise = fitNoise(points);
    if (noise) {
      sensor.noise.channels.push_back(noise->noise);
      if (summary.noiseFromPairs) {
        summary.colours[index(c)].electronsSigma = noise->electronsSigma;
        summary.colours[index(c)].readNoiseSigma = noise->readSigma;
      }
    } else {
      sensor.noise.channels.emplace_back();
    }
    for (const TransferPoint& p : points) {
      summary.photonTransfer.push_back({c, p.exposure, p.variance});
    }
  }

  // Dark frame and flat field.
  if (dark) {
    // A response that is not linear knows its black from the curve; what the dark frame adds is
    // each sample's distance from the mean.
    sensor.darkCounts = std::move(dark->mean);
    if (!summary.linear || std::ranges::any_of(clipped, std::identity{})) {
      forEachSample(camera, 1, [&](int x, int y, int s, int c) {
        sensor.darkCounts(x, y, s) +=
            static_cast<float>(summary.colours[index(c)].blackCount - dark->black[index(c)].value);
      });
    }
    sensor.darkExposureSeconds = input.darkFrames[0].metadata.exposureSeconds;
  }
  RETURN_IF_ERROR(stage(3));
  if (!input.flatFrames.empty()) {
    ASSIGN_OR_RETURN(auto flat, measureFlat(camera, sensor, input.flatFrames, options.flatColumns));
    for (int c = 0; c < camera.colours; ++c) {
      summary.colours[index(c)].flatSigma = flat.sigma[index(c)];
      for (int j = 0; j < flat.field.rows(); ++j) {
        for (int i = 0; i < flat.field.columns(); ++i) {
          summary.colours[index(c)].flatLowest =
              std::min(summary.colours[index(c)].flatLowest, flat.field.node(i, j, c));
        }
      }
    }
    sensor.flatField = std::move(flat.field);
  }
  RETURN_IF_ERROR(stage(4));
  return result;
}

std::string ResponseSummary::text(const SensorModel& sensor) const {
  const auto& info = pixelFormatInfo(sensor.format);
  double deviation = 0;
  for (const Colour& colour : colours) deviation = std::max(deviation, colour.linearDeviation);
  std::string out = fmt::format(
      "{} x {} {}: {} (largest deviation from a line {:.2f} % of full scale), saturates at {:g}\n",
      sensor.width, sensor.height, info.name, linear ? "linear" : "not linear", 100 * deviation,
      sensor.response.saturationCount());
  for (std::size_t c = 0; c < colours.size(); ++c) {
    const Colour& colour = colours[c];
    const ChannelNoise& noise = sensor.noise.channel(static_cast<int>(c));
    out += fmt::format(
        "{:>6}: black {:.2f} +- {:.2f} counts{}, curve +- {:.2f} % from {:.0f} to {:.0f} counts, "
        "residual {:.2f} counts, {:.0f} electrons to saturation{}, read noise {:.1f} e{}\n",
        colour.name, colour.blackCount, colour.blackSigma,
        colour.blackClipped ? " (clipped at 0)" : "", 100 * colour.curveSigma, colour.lowestCount,
        colour.highestCount, colour.residual, noise.electronsAtSaturation,
        colour.electronsSigma > 0 ? fmt::format(" +- {:.0f}", colour.electronsSigma) : "",
        noise.readNoiseElectrons,
        colour.readNoiseSigma > 0 ? fmt::format(" +- {:.1f}", colour.readNoiseSigma) : "");
  }
  out += fmt::format("noise from {}; {} places, {:.1f} % of them disagree between exposures\n",
                     noiseFromPairs ? "pairs of frames" : "the curve's residuals", places,
                     100 * disagreeing);
  if (timesEstimated) {
    double largest = 0;
    for (const Exposure& e : exposures) largest = std::max(largest, std::abs(e.timeError));
    out += fmt::format("exposure times differ from the nominal ones by up to {:.1f} %\n",
                       100 * largest);
  }
  if (darkFrames > 0) {
    out += fmt::format("{} hot pixels in {} dark frames\n", sensor.hotPixels.size(), darkFrames);
  }
  if (flatFrames > 0) {
    double lowest = 1;
    for (const Colour& colour : colours) lowest = std::min(lowest, colour.flatLowest);
    out += fmt::format("flat field of {} x {} nodes, falls to {:.1f} %, nodes +- {:.2f} %\n",
                       sensor.flatField->columns(), sensor.flatField->rows(), 100 * lowest,
                       100 * colours[0].flatSigma);
  }
  return out;
}

}  // namespace lightsketch
