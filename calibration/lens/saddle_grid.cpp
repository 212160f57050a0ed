#include "calibration/lens/saddle_grid.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <set>
#include <tuple>

namespace lightsketch {
namespace {

using Eigen::Vector2d;

constexpr double kPi = std::numbers::pi;
constexpr double kRingRadius = 4;          // pixels of the level; corners nearer than 8 are one
constexpr std::size_t kMaxSaddles = 4000;  // bounds the search for links
constexpr std::array<std::pair<int, int>, 4> kSteps{{{1, 0}, {0, 1}, {-1, 0}, {0, -1}}};

double angleBetween(double a, double b) { return std::remainder(a - b, 2 * kPi); }

Vector2d unit(double angle) { return {std::cos(angle), std::sin(angle)}; }

GridPlace moved(const GridPlace& place, int direction, int count) {
  const auto& step = kSteps[static_cast<std::size_t>(direction)];
  return {place.first + count * step.first, place.second + count * step.second};
}

const Vector2d* pointAt(const SaddleGrid& grid, const GridPlace& place) {
  const auto found = grid.find(place);
  return found == grid.end() ? nullptr : &found->second.saddle.point;
}

}  // namespace

std::optional<Vector2d> refineSaddle(const cv::Mat& smooth, const Vector2d& start, double sigma) {
  // A window cut nearer than this pulls the answer to the middle of its pixel.
  const int reach = static_cast<int>(std::ceil(3.2 * sigma));
  Vector2d p = start;
  for (int round = 0; round < 10; ++round) {
    const int cx = static_cast<int>(std::lround(p.x()));
    const int cy = static_cast<int>(std::lround(p.y()));
    if (cx < reach || cy < reach || cx >= smooth.cols - reach || cy >= smooth.rows - reach) {
      return std::nullopt;
    }
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> right = Eigen::Matrix<double, 6, 1>::Zero();
    for (int y = cy - reach; y <= cy + reach; ++y) {
      for (int x = cx - reach; x <= cx + reach; ++x) {
        const double u = x - p.x();
        const double v = y - p.y();
        const double weight = std::exp(-(u * u + v * v) / (2 * sigma * sigma));
        const Eigen::Matrix<double, 6, 1> terms{u * u, u * v, v * v, u, v, 1};
        normal.noalias() += weight * terms * terms.transpose();
        right.noalias() += weight * smooth.at<float>(y, x) * terms;
      }
    }
    const Eigen::Matrix<double, 6, 1> q = normal.ldlt().solve(right);
    const double determinant = 4 * q[0] * q[2] - q[1] * q[1];
    if (!(determinant < 0)) return std::nullopt;
    Vector2d step((q[1] * q[4] - 2 * q[2] * q[3]) / determinant,
                  (q[1] * q[3] - 2 * q[0] * q[4]) / determinant);
    if (step.norm() > 1) step.normalize();
    p += step;
    if (step.norm() < 1e-3) return p;
  }
  return std::nullopt;
}

SaddleFinder::SaddleFinder(const cv::Mat& grey) : grey_(grey) {
  cv::GaussianBlur(grey_, smooth_, {0, 0}, 1.2);
}

double SaddleFinder::at(const Vector2d& point) const {
  const double x = point.x();
  const double y = point.y();
  if (!(x >= 0 && y >= 0 && x < smooth_.cols - 1 && y < smooth_.rows - 1)) return std::nan("");
  const int x0 = static_cast<int>(x);
  const int y0 = static_cast<int>(y);
  const float* a = smooth_.ptr<float>(y0) + x0;
  const float* b = smooth_.ptr<float>(y0 + 1) + x0;
  const double u = x - x0;
  const double v = y - y0;
  return (1 - v) * ((1 - u) * a[0] + u * a[1]) + v * ((1 - u) * b[0] + u * b[1]);
}

std::optional<Saddle> SaddleFinder::check(const Vector2d& near, double radius) const {
  constexpr int kSamples = 32;
  std::array<double, kSamples> ring{};
  double low = 2;
  double high = -1;
  for (std::size_t i = 0; i < kSamples; ++i) {
    ring[i] = at(near + radius * unit(2 * kPi * static_cast<double>(i) / kSamples));
    if (std::isnan(ring[i])) return std::nullopt;
    low = std::min(low, ring[i]);
    high = std::max(high, ring[i]);
  }
  // Sensor noise in the dark must not pass for a pattern.
  const double contrast = high - low;
  if (contrast < 0.04) return std::nullopt;
  const double middle = 0.5 * (low + high);
  std::array<double, 4> crossings{};
  std::size_t count = 0;
  bool firstRises = false;
  for (std::size_t i = 0; i < kSamples; ++i) {
    const double a = ring[i] - middle;
    const double b = ring[(i + 1) % kSamples] - middle;
    if ((a < 0) == (b < 0)) continue;
    if (count == 4) return std::nullopt;
    if (count == 0) firstRises = a < 0;
    crossings[count++] = 2 * kPi * (static_cast<double>(i) + a / (a - b)) / kSamples;
  }
  if (count != 4) return std::nullopt;
  if (!firstRises) std::rotate(crossings.begin(), crossings.begin() + 1, crossings.end());
  // Edges pass straight through, and no sector is a sliver.
  constexpr double kStraight = 28 * kPi / 180;
  constexpr double kSliver = 16 * kPi / 180;
  for (std::size_t i = 0; i < 4; ++i) {
    const double width = std::fmod(crossings[(i + 1) % 4] - crossings[i] + 4 * kPi, 2 * kPi);
    if (width < kSliver) return std::nullopt;
  }
  for (std::size_t i = 0; i < 2; ++i) {
    if (std::abs(angleBetween(crossings[i] + kPi, crossings[i + 2])) > kStraight) {
      return std::nullopt;
    }
  }
  return Saddle{near, crossings, contrast};
}

std::vector<Saddle> SaddleFinder::findAll() const {
  // A saddle is where the Hessian's determinant is most negative.
  cv::Mat wide;
  cv::GaussianBlur(grey_, wide, {0, 0}, 1.8);
  const int width = wide.cols;
  const int height = wide.rows;
  cv::Mat response(height, width, CV_32F, cv::Scalar(0));
  for (int y = 1; y + 1 < height; ++y) {
    const float* above = wide.ptr<float>(y - 1);
    const float* here = wide.ptr<float>(y);
    const float* below = wide.ptr<float>(y + 1);
    float* out = response.ptr<float>(y);
    for (int x = 1; x + 1 < width; ++x) {
      const float xx = here[x - 1] - 2 * here[x] + here[x + 1];
      const float yy = above[x] - 2 * here[x] + below[x];
      const float xy = 0.25f * (below[x + 1] - below[x - 1] - above[x + 1] + above[x - 1]);
      out[x] = std::max(0.0f, xy * xy - xx * yy);
    }
  }
  cv::Mat highest;
  cv::dilate(response, highest, cv::getStructuringElement(cv::MORPH_RECT, {7, 7}));
  // An ideal step saddle of contrast 0.04 answers with (0.04 / (2 pi sigma^2))^2, about 4e-6.
  constexpr float kWeakest = 3e-6f;
  std::vector<std::pair<float, cv::Point>> peaks;
  for (int y = 1; y + 1 < height; ++y) {
    const float* r = response.ptr<float>(y);
    const float* h = highest.ptr<float>(y);
    for (int x = 1; x + 1 < width; ++x) {
      if (r[x] > kWeakest && r[x] == h[x]) peaks.emplace_back(r[x], cv::Point(x, y));
    }
  }
  std::sort(peaks.begin(), peaks.end(), [](const auto& a, const auto& b) {
    return a.first != b.first
               ? a.first > b.first
               : std::pair(a.second.y, a.second.x) < std::pair(b.second.y, b.second.x);
  });
  std::vector<Saddle> saddles;
  for (const auto& [strength, peak] : peaks) {
    // Where the gradient of the local quadric vanishes.
    const auto value = [&, x = peak.x, y = peak.y](int dx, int dy) {
      return static_cast<double>(wide.at<float>(y + dy, x + dx));
    };
    const double xx = value(-1, 0) - 2 * value(0, 0) + value(1, 0);
    const double yy = value(0, -1) - 2 * value(0, 0) + value(0, 1);
    const double xy = 0.25 * (value(1, 1) - value(-1, 1) - value(1, -1) + value(-1, -1));
    const double gx = 0.5 * (value(1, 0) - value(-1, 0));
    const double gy = 0.5 * (value(0, 1) - value(0, -1));
    const double determinant = xx * yy - xy * xy;
    const Vector2d shift((xy * gy - yy * gx) / determinant, (xy * gx - xx * gy) / determinant);
    if (!(shift.norm() < 2)) continue;
    if (const auto saddle = check(Vector2d(peak.x, peak.y) + shift, kRingRadius)) {
      saddles.push_back(*saddle);
      if (saddles.size() == kMaxSaddles) break;
    }
  }
  return saddles;
}

bool SaddleFinder::edgeBetween(const Saddle& from, int fromRay, const Saddle& to, int toRay) const {
  // A Bezier curve that leaves and arrives along the two rays: edges bend in a fisheye.
  const double length = (to.point - from.point).norm();
  const Vector2d a = from.point;
  const Vector2d b = a + length / 3 * unit(from.rays[static_cast<std::size_t>(fromRay)]);
  const Vector2d d = to.point;
  const Vector2d c = d + length / 3 * unit(to.rays[static_cast<std::size_t>(toRay)]);
  const double side = std::clamp(0.1 * length, 1.5, 8.0);
  // Rays 0 and 2: as the angle grows dark turns bright, so the bright side is at angle + 90.
  const double sign = fromRay % 2 == 0 ? 1 : -1;
  const double least = 0.25 * std::min(from.contrast, to.contrast);
  for (const double t : {0.2, 0.35, 0.5, 0.65, 0.8}) {
    const double s = 1 - t;
    const Vector2d point = s * s * s * a + 3 * s * s * t * b + 3 * s * t * t * c + t * t * t * d;
    const Vector2d along = (s * s * (b - a) + 2 * s * t * (c - b) + t * t * (d - c)).normalized();
    const Vector2d across(-along.y(), along.x());
    const double step = sign * (at(point + side * across) - at(point - side * across));
    if (!(step > least)) return false;
  }
  return true;
}

std::vector<SaddleGrid> SaddleFinder::grow(const std::vector<Saddle>& saddles,
                                           std::size_t minimum) const {
  const std::size_t count = saddles.size();
  const double reach = 0.35 * std::max(grey_.cols, grey_.rows);
  constexpr double kCone = 25 * kPi / 180;
  // link[i][ray] = (j, ray of j), the nearest saddle that an edge leads to.
  struct Link {
    std::size_t to;
    int ray;
  };
  std::vector<std::array<std::optional<Link>, 4>> links(count);
  struct Candidate {
    double distance;
    std::size_t to;
    int ray;
  };
  std::array<std::vector<Candidate>, 4> candidates;
  for (std::size_t i = 0; i < count; ++i) {
    for (auto& list : candidates) list.clear();
    for (std::size_t j = 0; j < count; ++j) {
      const Vector2d way = saddles[j].point - saddles[i].point;
      const double distance = way.norm();
      if (j == i || distance > reach || distance < 4) continue;
      const double angle = std::atan2(way.y(), way.x());
      for (std::size_t ray = 0; ray < 4; ++ray) {
        if (std::abs(angleBetween(angle, saddles[i].rays[ray])) > kCone) continue;
        for (std::size_t back = (ray + 1) % 2; back < 4; back += 2) {
          if (std::abs(angleBetween(angle + kPi, saddles[j].rays[back])) > kCone) continue;
          candidates[ray].push_back({distance, j, static_cast<int>(back)});
        }
      }
    }
    for (std::size_t ray = 0; ray < 4; ++ray) {
      auto& list = candidates[ray];
      const auto end =
          list.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(6, list.size()));
      std::partial_sort(list.begin(), end, list.end(),
                        [](const auto& a, const auto& b) { return a.distance < b.distance; });
      for (auto it = list.begin(); it != end; ++it) {
        if (!edgeBetween(saddles[i], static_cast<int>(ray), saddles[it->to], it->ray)) continue;
        links[i][ray] = Link{it->to, it->ray};
        break;
      }
    }
  }

  // Walk the links that both ends agree on; a walk that reaches one place by two corners, or one
  // corner at two places, keeps the first.
  std::vector<bool> taken(count, false);
  std::vector<SaddleGrid> grids;
  for (std::size_t start = 0; start < count; ++start) {
    if (taken[start]) continue;
    SaddleGrid grid;
    std::vector<std::pair<std::size_t, GridPlace>> queue;
    const auto add = [&](std::size_t index, const GridPlace& place, int turn) {
      if (taken[index] || grid.contains(place)) return;
      taken[index] = true;
      grid.emplace(place, GridCorner{saddles[index], turn});
      queue.emplace_back(index, place);
    };
    add(start, {0, 0}, 0);
    for (std::size_t next = 0; next < queue.size(); ++next) {
      const auto [index, place] = queue[next];
      const int turn = grid.at(place).turn;
      for (int ray = 0; ray < 4; ++ray) {
        const auto& link = links[index][static_cast<std::size_t>(ray)];
        if (!link) continue;
        const auto& back = links[link->to][static_cast<std::size_t>(link->ray)];
        if (!back || back->to != index || back->ray != ray) continue;
        const int direction = (ray + turn) % 4;
        add(link->to, moved(place, direction, 1), (direction + 2 - link->ray + 8) % 4);
      }
    }
    if (grid.size() >= minimum) grids.push_back(std::move(grid));
  }
  std::stable_sort(grids.begin(), grids.end(),
                   [](const auto& a, const auto& b) { return a.size() > b.size(); });
  return grids;
}

std::vector<GridPlace> SaddleFinder::emptyNeighbours(const SaddleGrid& grid) {
  std::set<GridPlace> places;
  for (const auto& [place, corner] : grid) {
    for (int direction = 0; direction < 4; ++direction) {
      const GridPlace next = moved(place, direction, 1);
      if (!grid.contains(next)) places.insert(next);
    }
  }
  return {places.begin(), places.end()};
}

std::optional<std::pair<Vector2d, double>> SaddleFinder::predict(const SaddleGrid& grid,
                                                                 const GridPlace& place) {
  Vector2d sum = Vector2d::Zero();
  double weight = 0;
  double step = 0;
  const auto vote = [&](const Vector2d& point, double w, double length) {
    sum += w * point;
    step += w * length;
    weight += w;
  };
  for (int direction = 0; direction < 4; ++direction) {
    const Vector2d* one = pointAt(grid, moved(place, direction, 1));
    const Vector2d* two = pointAt(grid, moved(place, direction, 2));
    const Vector2d* three = pointAt(grid, moved(place, direction, 3));
    const Vector2d* opposite = pointAt(grid, moved(place, (direction + 2) % 4, 1));
    if (one && opposite && direction < 2) {
      vote(0.5 * (*one + *opposite), 2, 0.5 * (*one - *opposite).norm());
    }
    if (one && two && three) {
      vote(3 * *one - 3 * *two + *three, 1, (2 * *one - 3 * *two + *three).norm());
    } else if (one && two) {
      vote(2 * *one - *two, 0.5, (*one - *two).norm());
    }
    // The fourth corner of a cell, corrected by how the next cell's differs.
    const int side = (direction + 1) % 4;
    const Vector2d* beside = pointAt(grid, moved(place, side, 1));
    const Vector2d* across = pointAt(grid, moved(moved(place, direction, 1), side, 1));
    if (one && beside && across) vote(*one + *beside - *across, 0.5, (*beside - *across).norm());
  }
  if (weight == 0) return std::nullopt;
  return std::pair(Vector2d(sum / weight), step / weight);
}

void SaddleFinder::prune(SaddleGrid& grid) {
  // predict() looks at places up to three away in a line.
  const auto deviation = [&](const SaddleGrid::value_type& entry) {
    const auto guess = predict(grid, entry.first);
    if (!guess) return 0.0;
    return (guess->first - entry.second.saddle.point).norm() / guess->second;
  };
  for (;;) {
    auto worst = grid.end();
    double largest = 0.25;
    for (auto it = grid.begin(); it != grid.end(); ++it) {
      const double d = deviation(*it);
      if (d > largest) std::tie(largest, worst) = std::pair(d, it);
    }
    if (worst == grid.end()) return;
    grid.erase(worst);
  }
}

std::optional<GridCorner> SaddleFinder::locate(const Vector2d& near, double step,
                                               double columnAngle, double rowAngle,
                                               bool bright) const {
  const int window = std::clamp(static_cast<int>(0.25 * step), 2, 6);
  const int border = window + 3;
  if (!(near.x() > border && near.y() > border && near.x() < grey_.cols - border &&
        near.y() < grey_.rows - border)) {
    return std::nullopt;
  }
  std::vector<cv::Point2f> point{{static_cast<float>(near.x()), static_cast<float>(near.y())}};
  // Twice: the window moves with the first answer.
  for (int round = 0; round < 2; ++round) {
    cv::cornerSubPix(grey_, point, {window, window}, {-1, -1},
                     {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.02});
  }
  const Vector2d found(point[0].x, point[0].y);
  if (!((found - near).norm() < std::max(2.0, step / 3))) return std::nullopt;
  const auto saddle = check(found, std::clamp(0.2 * step, 2.5, 6.0));
  if (!saddle) return std::nullopt;
  constexpr double kTolerance = 35 * kPi / 180;
  for (int ray = bright ? 0 : 1; ray < 4; ray += 2) {
    const auto next = static_cast<std::size_t>((ray + 1) % 4);
    if (std::abs(angleBetween(saddle->rays[static_cast<std::size_t>(ray)], columnAngle)) <
            kTolerance &&
        std::abs(angleBetween(saddle->rays[next], rowAngle)) < kTolerance) {
      return GridCorner{*saddle, (4 - ray) % 4};
    }
  }
  return std::nullopt;
}

std::optional<GridCorner> SaddleFinder::predicted(const SaddleGrid& grid,
                                                  const GridPlace& place) const {
  const auto guess = predict(grid, place);
  if (!guess) return std::nullopt;
  // Directions of the edges, and which diagonal is bright, from the neighbour that has both.
  for (int direction = 0; direction < 4; ++direction) {
    const auto neighbour = grid.find(moved(place, direction, 1));
    if (neighbour == grid.end()) continue;
    const auto corner = locate(guess->first, guess->second, rayAngle(neighbour->second, 0),
                               rayAngle(neighbour->second, 1), !brightDiagonal(neighbour->second));
    if (!corner) continue;
    // The edge to the neighbour must be there: corners of clutter lie near predictions too.
    const int fromRay = (direction - corner->turn + 8) % 4;
    const int toRay = (direction + 2 - neighbour->second.turn + 8) % 4;
    if (edgeBetween(corner->saddle, fromRay, neighbour->second.saddle, toRay)) return corner;
  }
  return std::nullopt;
}

}  // namespace lightsketch
