#include "capture/tracker/blob.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <numeric>

#include "capture/frame/median.h"

namespace lightsketch {
namespace {

constexpr int kSaturated = kFullScale * 97 / 100;
constexpr double kMinimumArea = 4;  // single hot pixels are not lamps
constexpr std::size_t kMostBlobs = 8;
constexpr std::size_t kMostRuns = 20000;  // more is a scene that changed as a whole, not a lamp

// How much a pixel is above the background, as a lamp counts it.
inline int excess(int now, int before) {
  const int difference = now - before;
  return now >= kSaturated && difference > kFullScale / 10 ? kFullScale : difference;
}

// Pixels x0 to x1 - 1 of a row that are above the threshold.
struct Run {
  int y, x0, x1;
  int parent;  // union-find over runs
};

int rootOf(std::vector<Run>& runs, int i) {
  auto at = [&](int k) -> Run& { return runs[static_cast<std::size_t>(k)]; };
  while (at(i).parent != i) {
    at(i).parent = at(at(i).parent).parent;
    i = at(i).parent;
  }
  return i;
}

// 8-connected components: each run is joined with those of the row above that touch it.
std::vector<Run> connectedRuns(const Image<std::uint16_t>& counts,
                               const Image<std::uint16_t>& level, const std::vector<int>& rowPeak,
                               int threshold) {
  std::vector<Run> runs;
  std::size_t aboveBegin = 0, aboveEnd = 0;
  for (int y = 0; y < counts.height(); ++y) {
    const std::size_t begin = runs.size();
    if (rowPeak[static_cast<std::size_t>(y)] > threshold) {
      const std::uint16_t* now = counts.row(y).data();
      const std::uint16_t* before = level.row(y).data();
      std::size_t above = aboveBegin;
      for (int x = 0; x < counts.width(); ++x) {
        if (excess(now[x], before[x]) <= threshold) continue;
        Run run{y, x, x, static_cast<int>(runs.size())};
        while (x < counts.width() && excess(now[x], before[x]) > threshold) ++x;
        run.x1 = x;
        runs.push_back(run);
        if (runs.size() > kMostRuns) return {};
        while (above < aboveEnd && runs[above].x1 < run.x0) ++above;
        for (std::size_t a = above; a < aboveEnd && runs[a].x0 <= run.x1; ++a) {
          const int r = rootOf(runs, static_cast<int>(a));
          runs[static_cast<std::size_t>(rootOf(runs, static_cast<int>(runs.size()) - 1))].parent =
              r;
        }
      }
    }
    aboveBegin = begin;
    aboveEnd = runs.size();
  }
  return runs;
}

// Light around the spot that is not of the spot (a lit wall, veiling glare): median of the
// difference along the window's border.
int surroundings(const Image<std::uint16_t>& counts, const Image<std::uint16_t>& level,
                 const Region& w) {
  std::vector<int> border;
  const auto add = [&](int x, int y) { border.push_back(counts(x, y) - level(x, y)); };
  for (int x = w.x; x < w.x + w.width; ++x) {
    add(x, w.y);
    add(x, w.y + w.height - 1);
  }
  for (int y = w.y; y < w.y + w.height; ++y) {
    add(w.x, y);
    add(w.x + w.width - 1, y);
  }
  return std::clamp(median(border), -kFullScale / 2, kFullScale / 2);
}

// Mean excess from 2.5 to 6 pixels outside the ellipse that the core fills.
double haloLevel(const Blob& blob, int base, const Image<std::uint16_t>& counts,
                 const Background& background) {
  const Eigen::Matrix2d information = (4 * blob.moments).inverse();  // of a uniform disc: R^2 / 4
  std::array<double, 8> sum{};
  std::array<int, 8> count{};
  const Region& w = blob.window;
  for (int y = w.y; y < w.y + w.height; ++y) {
    for (int x = w.x; x < w.x + w.width; ++x) {
      if (background.isStaticLight(x, y)) continue;
      const Eigen::Vector2d d(x + 0.5 - blob.pixel.x(), y + 0.5 - blob.pixel.y());
      const double outside = d.norm() * (1 - 1 / std::sqrt(d.dot(information * d) + 1e-9));
      if (outside < 2.5 || outside > 6) continue;
      const double turn = (std::atan2(d.y(), d.x()) + M_PI) / (2 * M_PI);
      const auto side = static_cast<std::size_t>(8 * turn) % 8;
      sum[side] += counts(x, y) - background.level()(x, y) - base;
      count[side] += 1;
    }
  }
  std::vector<double> levels;
  for (std::size_t i = 0; i < 8; ++i) {
    if (count[i] > 0) levels.push_back(sum[i] / count[i] / kFullScale);
  }
  if (levels.empty()) return 0;
  std::sort(levels.begin(), levels.end());
  return (levels[levels.size() / 2] + levels[(levels.size() - 1) / 2]) / 2;
}

void measure(Blob& blob, const Image<std::uint16_t>& counts, const Background& background) {
  const Image<std::uint16_t>& level = background.level();
  const Region& box = blob.box;
  int peak = 0;
  for (int y = box.y; y < box.y + box.height; ++y) {
    for (int x = box.x; x < box.x + box.width; ++x) {
      peak = std::max(peak, excess(counts(x, y), level(x, y)));
    }
  }
  // The halo belongs to the lamp: it is symmetric about it and not clipped by saturation.
  const int margin = 6 + static_cast<int>(1.5 * std::sqrt(blob.area / M_PI));
  const int x0 = std::max(0, box.x - margin);
  const int y0 = std::max(0, box.y - margin);
  const int x1 = std::min(counts.width(), box.x + box.width + margin);
  const int y1 = std::min(counts.height(), box.y + box.height + margin);
  blob.window = {x0, y0, x1 - x0, y1 - y0};
  blob.cut = box.x == 0 || box.y == 0 || box.x + box.width == counts.width() ||
             box.y + box.height == counts.height();

  const int base = surroundings(counts, level, blob.window);
  // Weights rise from half of the peak to near it: the halo is brighter on the side of a lit wall
  // than on that of the arm, and would draw the centroid (0.25 degrees on the simulated rig).
  const int floor = peak / 2;
  const int ceiling = std::max(peak * 85 / 100, floor + 1);
  constexpr int kClose = 3;  // pixels
  double sum = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0, staticPixels = 0;
  double vxx = 0, vxy = 0, vyy = 0;
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      const bool close = x >= box.x - kClose && x < box.x + box.width + kClose &&
                         y >= box.y - kClose && y < box.y + box.height + kClose;
      if (background.isStaticLight(x, y)) {
        if (close) staticPixels += 1;
        continue;
      }
      const int above = excess(counts(x, y), level(x, y) + base);
      if (above <= 0) continue;
      blob.flux += above;
      const double w = std::clamp(above, floor, ceiling) - floor;
      if (w <= 0 || !close) continue;
      const double dx = x + 0.5 - blob.pixel.x();
      const double dy = y + 0.5 - blob.pixel.y();
      sum += w;
      sx += w * dx;
      sy += w * dy;
      sxx += w * dx * dx;
      sxy += w * dx * dy;
      syy += w * dy * dy;
      if (above < ceiling) {  // only these pixels' noise moves the centroid
        vxx += dx * dx;
        vxy += dx * dy;
        vyy += dy * dy;
      }
    }
  }
  blob.flux /= kFullScale;
  blob.staticFraction = staticPixels / blob.area;
  if (sum <= 0) return;
  const Eigen::Vector2d shift(sx / sum, sy / sum);
  blob.pixel += shift;
  blob.moments << sxx / sum, sxy / sum, sxy / sum, syy / sum;
  blob.moments -= shift * shift.transpose();
  const double noise = background.noise() / sum;
  blob.centroidCovariance << vxx, vxy, vxy, vyy;
  blob.centroidCovariance *= noise * noise;
  blob.halo = haloLevel(blob, base, counts, background);
}

}  // namespace

std::vector<Blob> findBlobs(const Image<std::uint16_t>& counts, const Background& background) {
  const Image<std::uint16_t>& level = background.level();
  // One pass over the picture; everything after it touches bright rows only.
  std::vector<int> rowPeak(static_cast<std::size_t>(counts.height()));
  for (int y = 0; y < counts.height(); ++y) {
    const std::uint16_t* now = counts.row(y).data();
    const std::uint16_t* before = level.row(y).data();
    std::int16_t peak = 0;  // counts stay below 2^15
    for (int x = 0; x < counts.width(); ++x) {
      peak = std::max(peak, static_cast<std::int16_t>(excess(now[x], before[x])));
    }
    rowPeak[static_cast<std::size_t>(y)] = peak;
  }
  const int brightest = *std::max_element(rowPeak.begin(), rowPeak.end());
  const int lowest = std::max(static_cast<int>(10 * background.noise()), kFullScale / 20);
  const int threshold = std::max(lowest, brightest * 4 / 5);
  if (brightest <= threshold) return {};

  std::vector<Run> runs = connectedRuns(counts, level, rowPeak, threshold);
  std::vector<Blob> blobs;
  std::vector<int> blobOfRun(runs.size(), -1);
  for (int i = 0; i < static_cast<int>(runs.size()); ++i) {
    int& slot = blobOfRun[static_cast<std::size_t>(rootOf(runs, i))];
    const Run& run = runs[static_cast<std::size_t>(i)];
    if (slot < 0) {
      slot = static_cast<int>(blobs.size());
      blobs.push_back({});
      blobs.back().box = {run.x0, run.y, 0, 0};
    }
    Blob& blob = blobs[static_cast<std::size_t>(slot)];
    const int right = std::max(blob.box.x + blob.box.width, run.x1);
    blob.box.x = std::min(blob.box.x, run.x0);
    blob.box.width = right - blob.box.x;
    blob.box.height = run.y + 1 - blob.box.y;
    const double length = run.x1 - run.x0;
    blob.area += length;
    blob.pixel += length * Eigen::Vector2d((run.x0 + run.x1) / 2.0, run.y + 0.5);
  }
  std::erase_if(blobs, [](const Blob& blob) { return blob.area < kMinimumArea; });
  std::sort(blobs.begin(), blobs.end(),
            [](const Blob& a, const Blob& b) { return a.area > b.area; });
  if (blobs.size() > kMostBlobs) blobs.resize(kMostBlobs);

  for (Blob& blob : blobs) {
    blob.pixel /= blob.area;
    measure(blob, counts, background);
  }
  for (Blob& a : blobs) {
    for (const Blob& b : blobs) {
      const double apart = (a.pixel - b.pixel).norm();
      const double sizes = std::sqrt(a.area / M_PI) + std::sqrt(b.area / M_PI);
      if (&a != &b && apart < 2 * sizes + 4) a.crowded = true;
    }
  }
  std::sort(blobs.begin(), blobs.end(),
            [](const Blob& a, const Blob& b) { return a.flux > b.flux; });
  return blobs;
}

}  // namespace lightsketch
