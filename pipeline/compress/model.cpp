#include "pipeline/compress/model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace lightsketch {
namespace {

using Eigen::Index;

struct ElementTypes {
  ElementType E, U, V;
};

ElementTypes typesOf(Storage storage) {
  switch (storage) {
    case Storage::kFloat32:
      return {ElementType::kFloat32, ElementType::kFloat32, ElementType::kFloat32};
    case Storage::kFloat16:
      return {ElementType::kFloat16, ElementType::kFloat16, ElementType::kFloat16};
    case Storage::kQ8:
      return {ElementType::kInt8, ElementType::kFloat16, ElementType::kFloat16};
    case Storage::kPacked:
      return {ElementType::kInt8, ElementType::kInt16, ElementType::kInt16};
  }
  throw std::logic_error("unknown storage");
}

}  // namespace

const char* nameOf(Storage storage) {
  constexpr const char* kNames[] = {"f32", "f16", "q8", "packed"};
  return kNames[static_cast<int>(storage)];
}

void setFactors(RelightableModel& model, const Factors& factors, Storage storage) {
  if (storage == Storage::kPacked) throw std::logic_error("packed models need steps");
  const Index rows = factors.E.rows();
  const Index p = factors.E.cols();
  const Index q = factors.U.cols();
  model.layout = factors.layout;
  model.blockOffset = factors.blockOffset;
  model.rank = static_cast<int>(q);
  model.storage = storage;
  const ElementTypes types = typesOf(storage);

  model.E = {FactorValues(types.E, static_cast<std::size_t>(rows * p)), {}};
  const bool integers = types.E == ElementType::kInt8;
  for (Index r = 0; r < rows; ++r) {
    float scale = 1;
    if (integers) {
      const float largest = factors.E.row(r).cwiseAbs().maxCoeff();
      scale = largest > 0 ? largest / 127 : 1;
      model.E.scale.push_back(scale);
    }
    for (Index k = 0; k < p; ++k) {
      model.E.values.set(static_cast<std::size_t>(r * p + k), factors.E(r, k) / scale);
    }
  }
  constexpr Index kPanel = RelightableModel::kPanelRows;
  model.U = {FactorValues(types.U, static_cast<std::size_t>(model.panels() * q * kPanel)), {}};
  for (Index r = 0; r < rows; ++r) {
    for (Index k = 0; k < q; ++k) {
      model.U.values.set(static_cast<std::size_t>((r / kPanel * q + k) * kPanel + r % kPanel),
                         factors.U(r, k));
    }
  }
  model.V = {FactorValues(types.V, static_cast<std::size_t>(factors.V.size())), {}};
  for (Index column = 0; column < factors.V.cols(); ++column) {
    for (Index k = 0; k < q; ++k) {
      model.V.values.set(static_cast<std::size_t>(column * q + k), factors.V(k, column));
    }
  }
}

Factors factorsOf(const RelightableModel& model) {
  const auto scale = [](const StoredFactor& factor, Index i) {
    return factor.scale.empty() ? 1.0f : factor.scale[static_cast<std::size_t>(i)];
  };
  const Index rows = model.rows();
  const Index p = model.layout.pixelsPerBlock();
  const Index q = model.rank;
  const Index columns = 3 * static_cast<Index>(model.lights.size());
  constexpr Index kPanel = RelightableModel::kPanelRows;
  Factors factors{model.layout, model.blockOffset, RowMajorMatrixf(rows, p),
                  RowMajorMatrixf(rows, q), RowMajorMatrixf(q, columns)};
  for (Index r = 0; r < rows; ++r) {
    for (Index k = 0; k < p; ++k) {
      factors.E(r, k) = model.E.values.at(static_cast<std::size_t>(r * p + k)) * scale(model.E, r);
    }
    for (Index k = 0; k < q; ++k) {
      factors.U(r, k) =
          model.U.values.at(static_cast<std::size_t>((r / kPanel * q + k) * kPanel + r % kPanel)) *
          scale(model.U, k);
    }
  }
  for (Index column = 0; column < columns; ++column) {
    for (Index k = 0; k < q; ++k) {
      factors.V(k, column) =
          model.V.values.at(static_cast<std::size_t>(column * q + k)) * scale(model.V, k);
    }
  }
  return factors;
}

std::optional<std::string> misfitOf(const RelightableModel& model) {
  const BlockLayout& layout = model.layout;
  // blocks() and pixelsPerBlock() stay far inside an int.
  if (layout.width < 1 || layout.height < 1 || layout.blockSize < 1 || layout.blockSize > 1024 ||
      std::int64_t{layout.width} * layout.height > std::int64_t{1} << 31) {
    return fmt::format("a picture of {} x {} pixels in blocks of {}", layout.width, layout.height,
                       layout.blockSize);
  }
  const auto& offset = model.blockOffset;
  if (offset.size() != static_cast<std::size_t>(layout.blocks()) + 1 || offset.front() != 0 ||
      !std::is_sorted(offset.begin(), offset.end())) {
    return fmt::format("{} block offsets do not cut {} blocks", offset.size(), layout.blocks());
  }
  const auto rows = static_cast<std::size_t>(model.rows());
  const auto q = static_cast<std::size_t>(std::max(model.rank, 0));
  const auto columns = 3 * model.lights.size();
  const auto fits = [](const StoredFactor& factor, std::size_t count, std::size_t scales) {
    const bool integers =
        factor.values.type() == ElementType::kInt8 || factor.values.type() == ElementType::kInt16;
    return factor.values.count() == count && factor.scale.size() == (integers ? scales : 0);
  };
  if (columns == 0 || model.solidAngles.size() != model.lights.size() ||
      model.capturedDirections.size() != model.capturedIds.size()) {
    return fmt::format("{} lights, {} solid angles, {} captured directions of {} frames",
                       model.lights.size(), model.solidAngles.size(),
                       model.capturedDirections.size(), model.capturedIds.size());
  }
  if (!fits(model.E, rows * static_cast<std::size_t>(layout.pixelsPerBlock()), rows) ||
      !fits(model.U, static_cast<std::size_t>(model.panels()) * q * RelightableModel::kPanelRows,
            q) ||
      !fits(model.V, columns * q, q)) {
    return fmt::format(
        "E, U and V of {}, {} and {} numbers do not fit {} rows, rank {} and {} lights",
        model.E.values.count(), model.U.values.count(), model.V.values.count(), rows, q,
        model.lights.size());
  }
  return std::nullopt;
}

}  // namespace lightsketch
