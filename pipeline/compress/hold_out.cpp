#include "pipeline/compress/hold_out.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <set>
#include <sstream>

#include "capture/frame/file.h"
#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

constexpr const char* kRules = "use every:K:R, cells:K:R (0 <= R < K, K >= 2) or list:FILE";

std::optional<int> number(std::string_view text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < 0) return std::nullopt;
  return value;
}

struct Modulus {
  int step = 0;
  int remainder = 0;
  bool matches(int index) const { return index % step == remainder; }
};

// "8:4"
std::optional<Modulus> modulus(std::string_view text) {
  const auto colon = text.find(':');
  if (colon == std::string_view::npos) return std::nullopt;
  const auto step = number(text.substr(0, colon));
  const auto remainder = number(text.substr(colon + 1));
  if (!step || !remainder || *step < 2 || *remainder >= *step) return std::nullopt;
  return Modulus{*step, *remainder};
}

// Whole cells of a grid with about eight frames each. A frame closer to a held-out cell than half
// the frames' own distance (a sixth of the cells') belongs to the margin: it would be a near twin
// of a held-out one.
void splitByCells(const Sketch& sketch, const std::vector<int>& active, Modulus rule,
                  HoldOut& result) {
  const int nodes = std::clamp(static_cast<int>(active.size()) / 8, 64, 10000);
  const auto domain =
      std::any_of(active.begin(), active.end(),
                  [&](int id) {
                    return sketch.frames()[static_cast<std::size_t>(id)].light.direction.z() < 0;
                  })
          ? LightGrid::Domain::kSphere
          : LightGrid::Domain::kHemisphere;
  const auto grid = LightGrid::create(nodes, domain);
  const double chord = grid->spacing().radians() / 6;
  for (const int id : active) {
    const Eigen::Vector3d& direction =
        sketch.frames()[static_cast<std::size_t>(id)].light.direction;
    const int cell = grid->nearest(direction);
    if (rule.matches(cell)) {
      result.heldOut.push_back(id);
      continue;
    }
    // Distance to another cell's bisector: how much farther its node is, over twice their distance.
    const Eigen::Vector3d& own = grid->directions()[static_cast<std::size_t>(cell)];
    bool close = false;
    for (int k = rule.remainder; k < grid->size() && !close; k += rule.step) {
      const Eigen::Vector3d& other = grid->directions()[static_cast<std::size_t>(k)];
      close = (own - other).dot(direction) < chord * (own - other).norm();
    }
    (close ? result.margin : result.training).push_back(id);
  }
}

Result<void> splitByList(const Sketch& sketch, const std::filesystem::path& file, HoldOut& result) {
  ASSIGN_OR_RETURN(const std::string text, readFile(file));
  std::istringstream lines(text);
  std::set<int> held;
  std::string line;
  for (int at = 1; std::getline(lines, line); ++at) {
    line.erase(line.find_last_not_of(" \t\r") + 1);
    line.erase(0, line.find_first_not_of(" \t"));
    if (line.empty()) continue;
    const auto id = number(line);
    if (!id || *id >= static_cast<int>(sketch.frames().size())) {
      return failure(ErrorCode::kInvalidArgument, "{}: line {}: '{}' is not a frame id of {}",
                     file.string(), at, line, sketch.folder().string());
    }
    held.insert(*id);
  }
  for (const int id : sketch.activeFrames()) {
    (held.contains(id) ? result.heldOut : result.training).push_back(id);
  }
  return {};
}

}  // namespace

Result<HoldOut> applyHoldOut(const Sketch& sketch, std::string_view rule) {
  HoldOut result;
  result.rule = rule;
  const std::vector<int> active = sketch.activeFrames();
  if (active.empty()) {
    return failure(ErrorCode::kInvalidArgument, "{}: no frames; record or import some first",
                   sketch.folder().string());
  }
  if (rule.empty()) {
    result.training = active;
    return result;
  }
  constexpr std::string_view kEvery = "every:";
  constexpr std::string_view kCells = "cells:";
  constexpr std::string_view kList = "list:";
  if (rule.starts_with(kList)) {
    RETURN_IF_ERROR(splitByList(sketch, std::string(rule.substr(kList.size())), result));
  } else {
    const bool every = rule.starts_with(kEvery);
    const auto parts =
        every || rule.starts_with(kCells) ? modulus(rule.substr(kEvery.size())) : std::nullopt;
    if (!parts) {
      return failure(ErrorCode::kInvalidArgument, "hold-out rule '{}' is unknown; {}", rule,
                     kRules);
    }
    if (every) {
      // By id, so that dropping a frame moves no other from one set to the other.
      for (const int id : active)
        (parts->matches(id) ? result.heldOut : result.training).push_back(id);
    } else {
      splitByCells(sketch, active, *parts, result);
    }
  }
  if (result.heldOut.empty() || result.training.empty()) {
    return failure(
        ErrorCode::kInvalidArgument,
        "hold-out rule '{}' leaves {} frames to learn from and {} to measure on; both are needed",
        rule, result.training.size(), result.heldOut.size());
  }
  return result;
}

std::string defaultHoldOut(const Sketch& sketch) {
  constexpr std::size_t kManyFrames = 200;
  const bool freeHand = sketch.manifest().directions == 0;
  return freeHand && sketch.activeFrames().size() >= kManyFrames ? "cells:8:4" : "every:8:4";
}

}  // namespace lightsketch
