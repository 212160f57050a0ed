#include "pipeline/illumination/turnable_environment.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "pipeline/illumination/lat_long.h"

namespace lightsketch {
namespace {

using Eigen::Array4d;
using Eigen::Vector3d;
using std::numbers::pi;

// From `position` (in columns of the unturned map) up to the next run's the row lies in `cell`.
struct Run {
  float position = 0;
  int cell = -1;
};

// Columns of the table's grid: six to the side of a small cell, and for few lights as many more as
// cost little.
int columnsFor(const LightCells& cells) {
  std::vector<double> areas = cells.solidAngles();
  const auto rank = areas.begin() + static_cast<std::ptrdiff_t>(areas.size() / 20);
  std::nth_element(areas.begin(), rank, areas.end());
  return std::clamp(static_cast<int>(6 * 2 * pi / std::sqrt(std::max(*rank, 1e-6))), 512, 2048);
}

// The parts of a circle of latitude that lie in one cell each. Cells are convex, so between steps
// of a third of a cell nothing is missed but slivers; where two steps differ, the change is
// searched.
std::vector<Run> runsOf(const LightCells& cells, double v, int columns, int tableColumns) {
  const auto cellAt = [&](double u) { return cells.cellOf(latLongDirection(u, v)); };
  const int steps = std::max(16, static_cast<int>(tableColumns / 2 * std::sin(pi * v)));
  std::vector<Run> runs{{0, cellAt(0)}};
  for (int step = 0; step < steps; ++step) {
    const double next = static_cast<double>(step + 1) / steps;
    const int last = cellAt(next);
    // More than one change may lie in a step: each search finds the first change of some cell.
    double from = static_cast<double>(step) / steps;
    while (runs.back().cell != last) {
      double low = from;
      double high = next;
      int beyond = last;
      for (int k = 0; k < 12; ++k) {
        const double middle = (low + high) / 2;
        const int cell = cellAt(middle);
        (cell == runs.back().cell ? low : high) = middle;
        if (cell != runs.back().cell) beyond = cell;
      }
      runs.push_back({static_cast<float>((low + high) / 2 * columns), beyond});
      from = high;
    }
  }
  runs.push_back({static_cast<float>(columns), -1});
  return runs;
}

}  // namespace

struct TurnableEnvironment::Tables {
  // Running sums of radiance along each row of the map, from its left edge to before each column
  // and to the right edge: (columns + 1) a row, over `columns`. Doubles, so that the difference of
  // two does not lose the sky beside a sun.
  std::vector<Array4d> sums;
  int columns = 0;
  int rowsPerMapRow = 1;              // of the table
  std::vector<std::size_t> firstRun;  // table rows + 1
  std::vector<Run> runs;
  std::vector<double> rowArea;  // steradians, all the way round
  // Lights whose cell is too small for any run take the map's value there.
  struct Lone {
    int light = 0;
    int mapRow = 0;
    double position = 0;
  };
  std::vector<Lone> lone;
  std::vector<int> twin;      // per light: the light whose cell it shares
  std::vector<double> scale;  // per light: of the sum over the cell

  // The integral of a map row's radiance up to a position, in turns.
  Array4d upTo(const Array4d* row, double position) const {
    const int whole = static_cast<int>(position);
    if (whole >= columns) return row[columns] + within(row, position - columns, whole - columns);
    return within(row, position, whole);
  }
  static Array4d within(const Array4d* row, double position, int whole) {
    return row[whole] + (position - whole) * (row[whole + 1] - row[whole]);
  }
  const Array4d* row(int mapRow) const {
    return sums.data() + static_cast<std::size_t>(mapRow) * (static_cast<std::size_t>(columns) + 2);
  }
};

Result<TurnableEnvironment> TurnableEnvironment::create(const RadianceImage& latLong,
                                                        std::span<const Vector3d> lights,
                                                        const EnvironmentOptions& options) {
  RETURN_IF_ERROR(checkEnvironment(latLong, options));
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(lights, options.cells));
  auto tables = std::make_shared<Tables>();
  Tables& t = *tables;

  // Maps finer than the lights can tell are averaged, by area, so that no energy is lost.
  const int wanted = columnsFor(cells);
  int box = std::max(1, latLong.width() / wanted);
  while (latLong.height() % box != 0) --box;
  const int rows = latLong.height() / box;
  t.columns = latLong.width() / box;
  t.sums.assign(static_cast<std::size_t>(rows) * (static_cast<std::size_t>(t.columns) + 2),
                Array4d::Zero());
  oneapi::tbb::parallel_for(0, rows, [&](int y) {
    Array4d* const out =
        t.sums.data() + static_cast<std::size_t>(y) * (static_cast<std::size_t>(t.columns) + 2);
    const auto area = [&](int row, int count) {
      return latLongBandArea(static_cast<double>(row) / latLong.height(),
                             static_cast<double>(row + count) / latLong.height());
    };
    for (int k = 0; k < box; ++k) {
      const int mapRow = y * box + k;
      const double weight = area(mapRow, 1) / area(y * box, box) / latLong.width();
      const float* in = latLong.row(mapRow).data();
      for (int x = 0; x < latLong.width(); ++x, in += 3) {
        out[x / box + 1] += weight * Array4d(in[0], in[1], in[2], 0);
      }
    }
    for (int x = 0; x < t.columns; ++x) out[x + 1] += out[x];
    out[t.columns + 1] = out[t.columns];  // read where a position is the right edge
  });

  // The cells, row by row.
  t.rowsPerMapRow = std::max(1, (wanted / 2 + rows - 1) / rows);
  const int tableRows = rows * t.rowsPerMapRow;
  std::vector<std::vector<Run>> runs(static_cast<std::size_t>(tableRows));
  oneapi::tbb::parallel_for(0, tableRows, [&](int y) {
    runs[static_cast<std::size_t>(y)] = runsOf(cells, (y + 0.5) / tableRows, t.columns, wanted);
  });
  std::vector<double> covered(lights.size(), 0);
  for (int y = 0; y < tableRows; ++y) {
    const auto& line = runs[static_cast<std::size_t>(y)];
    t.rowArea.push_back(latLongBandArea(static_cast<double>(y) / tableRows, (y + 1.0) / tableRows));
    t.firstRun.push_back(t.runs.size());
    t.runs.insert(t.runs.end(), line.begin(), line.end());
    for (std::size_t k = 0; k + 1 < line.size(); ++k) {
      if (line[k].cell < 0) continue;
      covered[static_cast<std::size_t>(line[k].cell)] +=
          t.rowArea.back() * (line[k + 1].position - line[k].position) / t.columns;
    }
  }
  t.firstRun.push_back(t.runs.size());

  for (std::size_t i = 0; i < lights.size(); ++i) {
    const int twin = cells.firstTwin(static_cast<int>(i));
    const double sampled = covered[static_cast<std::size_t>(twin)];
    t.twin.push_back(twin);
    t.scale.push_back(cells.solidAngles()[i] / options.lampIrradiance /
                      (sampled > 0 ? sampled : 1));
    if (sampled > 0 || twin != static_cast<int>(i)) continue;
    const double u = 0.5 - std::atan2(lights[i].x(), lights[i].z()) / (2 * pi);
    const double v = 0.5 - std::asin(std::clamp(lights[i].y(), -1.0, 1.0)) / pi;
    t.lone.push_back(
        {static_cast<int>(i), std::min(static_cast<int>(v * rows), rows - 1), u * t.columns});
  }
  TurnableEnvironment environment;
  environment.tables_ = std::move(tables);
  return environment;
}

int TurnableEnvironment::lightCount() const { return static_cast<int>(tables_->twin.size()); }

void TurnableEnvironment::intensities(double yawDegrees, LightIntensities& out) const {
  const Tables& t = *tables_;
  // Turned from +z towards +x, which is to the left in the map: what is seen at a column stood to
  // its right before.
  const double turns = yawDegrees / 360 - std::floor(yawDegrees / 360);
  const double shift = std::min(turns * t.columns, std::nextafter(t.columns, 0.0));
  std::vector<Array4d> cells(t.twin.size(), Array4d::Zero());
  for (std::size_t y = 0; y < t.rowArea.size(); ++y) {
    const Array4d* const row = t.row(static_cast<int>(y) / t.rowsPerMapRow);
    const Run* run = t.runs.data() + t.firstRun[y];
    const Run* const end = t.runs.data() + t.firstRun[y + 1] - 1;
    for (Array4d before = t.upTo(row, run->position + shift); run != end; ++run) {
      const Array4d after = t.upTo(row, run[1].position + shift);
      if (run->cell >= 0) {
        cells[static_cast<std::size_t>(run->cell)] += t.rowArea[y] * (after - before);
      }
      before = after;
    }
  }
  for (const auto& lone : t.lone) {
    // The mean over one column's width about the light.
    const double left = std::fmod(lone.position + shift - 0.5 + t.columns, t.columns);
    const Array4d* const row = t.row(lone.mapRow);
    cells[static_cast<std::size_t>(lone.light)] =
        t.columns * (t.upTo(row, left + 1) - t.upTo(row, left));
  }
  out.resize(static_cast<Eigen::Index>(t.twin.size()), 3);
  for (std::size_t i = 0; i < t.twin.size(); ++i) {
    out.row(static_cast<Eigen::Index>(i)) =
        (t.scale[i] * cells[static_cast<std::size_t>(t.twin[i])].head<3>())
            .cast<float>()
            .transpose();
  }
}

}  // namespace lightsketch
