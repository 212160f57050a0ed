// A person with a lamp: follows the program's wishes late, not quite exactly and not always.
#pragma once

#include <cstdint>
#include <memory>

#include "capture/rig/gige_device.h"
#include "capture/rig/lamp_motion.h"

namespace lightsketch {

struct HandOptions {
  // How far from the subject the lamp is held: in between, wandering slowly.
  double minDistanceMetres = kLampDistanceMetres;
  double maxDistanceMetres = kLampDistanceMetres;
  // Waves the lamp all over the hemisphere, in a spiral of some 25 s that repeats, without a guide
  // and without lapses.
  bool sweeps = false;
};

// Simulated in steps of 5 ms; the path is a function of the seed and of the guides with their
// times. Thread-safe.
class SimulatedHand final : public LampMotion {
 public:
  explicit SimulatedHand(std::uint32_t seed, const HandOptions& options = {});
  ~SimulatedHand() override;

  // What the program shows the person at `timeSeconds`. They react a quarter of a second later.
  void guide(const Guide& guide, double timeSeconds);
  void advanceTo(double timeSeconds) override;
  LampState at(double timeSeconds) const override;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// A spiral over the hemisphere that repeats, without tremor: for frames rendered beforehand.
class SpiralMotion final : public LampMotion {
 public:
  explicit SpiralMotion(double periodSeconds) : periodSeconds_(periodSeconds) {}
  void advanceTo(double) override {}
  LampState at(double timeSeconds) const override;

 private:
  double periodSeconds_;
};

}  // namespace lightsketch
