#include "pipeline/compress/encoded_domain.h"

#include <algorithm>
#include <cmath>

#include "capture/frame/srgb.h"

// Vectors of a length known only at run time do not fit in arrays.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pipeline/compress/encoded_domain.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
//
#include "hwy/contrib/math/math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lightsketch {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;
constexpr D d;

V power(V base, float exponent) {
  return hn::Exp(d, hn::Mul(hn::Set(d, exponent), hn::Log(d, base)));
}

// IEC 61966-2-1, from 0 up.
V srgbDecodeV(V e) {
  const V bent = power(hn::MulAdd(e, hn::Set(d, 1 / 1.055f), hn::Set(d, 0.055f / 1.055f)), 2.4f);
  return hn::IfThenElse(hn::Le(e, hn::Set(d, 0.04045f)), hn::Mul(e, hn::Set(d, 1 / 12.92f)), bent);
}

V srgbEncodeV(V x) {
  const V line = hn::Set(d, 0.0031308f);
  const V bent =
      hn::MulSub(hn::Set(d, 1.055f), power(hn::Max(x, line), 1 / 2.4f), hn::Set(d, 0.055f));
  return hn::IfThenElse(hn::Le(x, line), hn::Mul(x, hn::Set(d, 12.92f)), bent);
}

// exp(x) - 1 cancels below the floor, where one level of 16 bits is far coarser still.
V logDecodeV(V e) { return hn::Mul(hn::Set(d, kLogFloor), hn::Sub(hn::Exp(d, e), hn::Set(d, 1))); }

V within(const DomainPrediction& prediction, std::size_t i) {
  return hn::Min(hn::Max(hn::LoadU(d, prediction.values + i), hn::Zero(d)),
                 hn::Set(d, prediction.largest));
}

// Calls step(i) for whole vectors; returns how many values they held.
template <class Step>
std::size_t wholeVectors(std::size_t count, Step step) {
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) step(i);
  return i;
}

void SrgbFromLog(float* values, std::size_t count) {
  const auto step = [&](float* at) {
    hn::StoreU(srgbEncodeV(hn::Max(logDecodeV(hn::LoadU(d, at)), hn::Zero(d))), d, at);
  };
  const std::size_t done = wholeVectors(count, [&](std::size_t i) { step(values + i); });
  float rest[HWY_MAX_BYTES / sizeof(float)] = {};
  std::copy(values + done, values + count, rest);
  step(rest);
  std::copy(rest, rest + (count - done), values + done);
}

void MixDomains(const DomainPrediction& srgb, const DomainPrediction& log, std::size_t count,
                float white, float* linear) {
  const auto step = [&](const DomainPrediction& s, const DomainPrediction& l, std::size_t i,
                        float* out) {
    V value;
    if (log.share == 0) {
      value = srgbDecodeV(within(s, i));
    } else if (srgb.share == 0) {
      value = logDecodeV(within(l, i));
    } else {
      const V root = hn::MulAdd(
          hn::Set(d, srgb.share), hn::Sqrt(srgbDecodeV(within(s, i))),
          hn::Mul(hn::Set(d, log.share), hn::Sqrt(hn::Max(logDecodeV(within(l, i)), hn::Zero(d)))));
      value = hn::Mul(root, root);
    }
    hn::StoreU(hn::Mul(hn::Max(value, hn::Zero(d)), hn::Set(d, white)), d, out);
  };
  const std::size_t done =
      wholeVectors(count, [&](std::size_t i) { step(srgb, log, i, linear + i); });
  constexpr std::size_t kLanes = HWY_MAX_BYTES / sizeof(float);
  float rest[3][kLanes] = {};
  if (srgb.share != 0) std::copy(srgb.values + done, srgb.values + count, rest[0]);
  if (log.share != 0) std::copy(log.values + done, log.values + count, rest[1]);
  step({rest[0], srgb.share, srgb.largest}, {rest[1], log.share, log.largest}, 0, rest[2]);
  std::copy(rest[2], rest[2] + (count - done), linear + done);
}

}  // namespace HWY_NAMESPACE
}  // namespace lightsketch
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lightsketch {

HWY_EXPORT(SrgbFromLog);
HWY_EXPORT(MixDomains);

float encodeValue(EncodedDomain domain, float linear) {
  return domain == EncodedDomain::kSrgb ? srgbEncode(linear)
                                        : std::log1p(std::max(linear, 0.0f) / kLogFloor);
}

void srgbFromLog(float* values, std::size_t count) {
  HWY_DYNAMIC_DISPATCH(SrgbFromLog)(values, count);
}

void mixDomains(const DomainPrediction& srgb, const DomainPrediction& log, std::size_t count,
                float white, float* linear) {
  HWY_DYNAMIC_DISPATCH(MixDomains)(srgb, log, count, white, linear);
}

}  // namespace lightsketch
#endif
