#include "capture/tracker/lamp_tracker.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <vector>

#include "capture/frame/direction.h"
#include "capture/tracker/background.h"
#include "capture/tracker/blob.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kLearnFromTracking = 8;  // frames that track() learns from if nobody else taught it
constexpr int kFewestLearned = 3;

// Motion of a hand, at the source camera.
constexpr Angle kGateSlack = Angle::degrees(2);
constexpr double kGateAcceleration = 5;                        // rad/s^2
constexpr double kFastestHand = Angle::degrees(90).radians();  // a second
constexpr Angle kWidestGate = Angle::degrees(15);
constexpr double kTrackLifetime = 0.35;  // seconds without a blob
constexpr Angle kResumeAngle = Angle::degrees(10);
constexpr double kResumeSeconds = 0.2;
constexpr double kPassageSeconds = 0.5;  // past a lamp of the room

// Brightness, as differences of logarithms.
constexpr double kStepTolerance = 0.20;     // against the last frames of the same track
constexpr double kModelTolerance = 0.25;    // against what the lamp had in this direction
constexpr double kTrackedTolerance = 0.60;  // the same while the track is unbroken
constexpr double kResumeTolerance = 0.15;
constexpr double kMirrorTolerance = 0.15;  // downwards, where reflections were seen
constexpr double kClearlyStronger = 0.25;  // than any rival
constexpr int kModelTrusted = 100;         // accepted observations

constexpr int kHitsToAcquire = 5;
constexpr int kHitsToReacquire = 3;
constexpr int kHitsBeforeMirror = 6;
constexpr double kHandTremorPixels = 0.4;  // a held lamp never stands stiller than this for long
constexpr double kRoundness = 0.7;         // minor over major axis
constexpr int kMirrorCell = 16;            // pixels

// Bayesian linear regression of log brightness on the spherical harmonics of the direction up to
// second order: the lamp is held at some distance from the subject, not from the camera, and the
// lens shrinks and dims it towards the rim, so its brightness is a smooth function of direction.
// Says how well it knows.
class BrightnessModel {
 public:
  void add(const Vector3d& direction, double logBrightness) {
    const Features f = features(direction);
    if (count_ > 0) {
      const double residual = logBrightness - predict(direction);
      variance_ += (std::min(residual * residual, 0.25) - variance_) / std::min(count_ + 10, 200);
    }
    // Successive frames say nearly the same: each counts for a fifth. Old ones fade in a minute.
    constexpr double kWeight = 0.2;
    constexpr double kFade = 0.999;
    precision_ =
        prior() + kFade * (precision_ - prior()) + kWeight / kNominalVariance * f * f.transpose();
    information_ = kFade * information_ + kWeight / kNominalVariance * logBrightness * f;
    factor_.compute(precision_);
    weights_ = factor_.solve(information_);
    ++count_;
  }
  int count() const { return count_; }
  double predict(const Vector3d& d) const { return weights_.dot(features(d)); }
  double sigma(const Vector3d& d) const {
    const Features f = features(d);
    return std::sqrt(f.dot(factor_.solve(f)) + variance_);
  }

 private:
  static constexpr int kTerms = 9;
  static constexpr double kNominalVariance = 0.01;  // of one observation
  using Features = Eigen::Matrix<double, kTerms, 1>;
  using Precision = Eigen::Matrix<double, kTerms, kTerms>;
  static Features features(const Vector3d& d) {
    return (Features() << 1, d.x(), d.y(), d.z(), d.x() * d.y(), d.y() * d.z(), d.z() * d.x(),
            d.x() * d.x() - d.y() * d.y(), d.z() * d.z() - 1.0 / 3)
        .finished();
  }
  // Nothing is known of the brightness itself; it may change by about half across the field.
  static Precision prior() {
    return (Features() << 1e-6, 4, 4, 4, 8, 8, 8, 8, 8).finished().asDiagonal();
  }
  Precision precision_ = prior();
  Features information_ = Features::Zero();
  Features weights_ = Features::Zero();
  Eigen::LDLT<Precision> factor_{precision_};
  double variance_ = 0.01;
  int count_ = 0;
};

struct Candidate {
  Blob blob;
  Vector3d direction;
  double logFlux = 0;
  double logHalo = 0;
  double roundness = 1;
  // What tells a light from its own reflection: of two saturated spots the sizes are alike, the
  // halos are not.
  double strength() const { return (logFlux + logHalo) / 2; }
};

struct Track {
  int id = 0;
  Vector3d direction;
  Vector3d velocity = Vector3d::Zero();  // per second, tangential
  Vector3d birth;                        // where it was first seen
  Vector2d birthPixel;
  TimePoint time;
  int hits = 0;
  int proven = 0;        // of these, in a row and since it last failed a test
  double travelled = 0;  // largest distance from birth, radians
  double travelledPixels = 0;
  double logFlux = 0;   // of the last frame
  double residual = 0;  // brightness against the model, smoothed over accepted frames
  TimePoint accepted;   // last frame in which it was the lamp
  int besideLamp = 0;   // frames in which the lamp was elsewhere at the same time
  bool reflection = false;
  int candidate = -1;  // in this frame
};

double roundnessOf(const Matrix2d& moments) {
  const Eigen::SelfAdjointEigenSolver<Matrix2d> solver(moments, Eigen::EigenvaluesOnly);
  const Vector2d e = solver.eigenvalues();
  return e[1] > 0 ? std::sqrt(std::max(0.0, e[0]) / e[1]) : 0;
}

}  // namespace

struct LampTracker::State {
  std::shared_ptr<const CameraModel> model;
  LampTrackerOptions options;
  Background background;
  std::vector<Track> tracks;
  int nextId = 1;
  int lamp = 0;  // id of the lamp's track; 0: none
  BrightnessModel flux;
  BrightnessModel halo;
  // Picture cells in which reflections were seen beside the lamp: no lamp is acquired there.
  std::set<std::pair<int, int>> mirrors;
  int strongerRival = 0;  // frames in a row
  int brighterThanEver = 0;
  bool teachItself = false;  // nobody called learnBackground()
  std::deque<LampObservation> trail;

  Result<Image<std::uint16_t>> read(const Frame& frame) const;
  std::vector<Candidate> candidatesIn(const Image<std::uint16_t>& counts) const;
  void associate(const std::vector<Candidate>& candidates, TimePoint time);
  Track* find(int id);
  void forgetLamp();
  // Why a lamp could not be measured where this candidate is; empty if it could.
  std::string badPlace(const Candidate& candidate) const;
  // Why this candidate, on this track, does not look like the lamp; empty if it does.
  std::string objection(const Track& track, const Candidate& candidate, double smearPixels) const;
  bool resumes(const Track& track, const Candidate& candidate);
  Track* acquire(const std::vector<Candidate>& candidates, std::string& reason);
  LampObservation observe(const Track& track, const Candidate& candidate,
                          const std::vector<Candidate>& all, const FrameMetadata& metadata,
                          double smearPixels) const;
  TrackResult judge(const std::vector<Candidate>& candidates, const FrameMetadata& metadata);
  Eigen::Matrix<double, 3, 2> directionPerPixel(const Vector2d& pixel) const;
  std::pair<int, int> mirrorCell(const Vector2d& pixel) const {
    return {static_cast<int>(pixel.x()) / kMirrorCell, static_cast<int>(pixel.y()) / kMirrorCell};
  }
  bool nearMirror(const Vector2d& pixel) const;
  double residualOf(const Candidate& candidate) const {
    return candidate.logFlux - (flux.count() > 0 ? flux.predict(candidate.direction) : 0.0);
  }
};

Result<Image<std::uint16_t>> LampTracker::State::read(const Frame& frame) const {
  if (frame.width != model->width() || frame.height != model->height()) {
    return failure(ErrorCode::kInvalidArgument,
                   "source frame {}: {} x {} pixels, but the camera model is for {} x {}; set the "
                   "camera's region or use the model of this camera",
                   frame.metadata.id, frame.width, frame.height, model->width(), model->height());
  }
  return normalisedCounts(frame, options.blackLevel);
}

Eigen::Matrix<double, 3, 2> LampTracker::State::directionPerPixel(const Vector2d& pixel) const {
  Eigen::Matrix<double, 3, 2> jacobian = Eigen::Matrix<double, 3, 2>::Zero();
  constexpr double kStep = 0.5;
  for (int axis = 0; axis < 2; ++axis) {
    const Vector2d step = kStep * Vector2d::Unit(axis);
    const auto here = model->unproject(pixel);
    const auto ahead = model->unproject(pixel + step);
    const auto behind = model->unproject(pixel - step);
    if (ahead && behind)
      jacobian.col(axis) = (*ahead - *behind) / (2 * kStep);
    else if (here && ahead)
      jacobian.col(axis) = (*ahead - *here) / kStep;
    else if (here && behind)
      jacobian.col(axis) = (*here - *behind) / kStep;
  }
  return jacobian;
}

bool LampTracker::State::nearMirror(const Vector2d& pixel) const {
  const auto [cx, cy] = mirrorCell(pixel);
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      if (mirrors.contains({cx + dx, cy + dy})) return true;
    }
  }
  return false;
}

std::vector<Candidate> LampTracker::State::candidatesIn(const Image<std::uint16_t>& counts) const {
  std::vector<Candidate> candidates;
  for (Blob& blob : findBlobs(counts, background)) {
    const auto direction = model->unproject(blob.pixel);
    if (!direction) continue;
    if (options.allowedNormal.dot(*direction) < options.allowedMinimum) continue;
    Candidate candidate;
    candidate.direction = *direction;
    candidate.logFlux = std::log(std::max(blob.flux, 1e-3));
    candidate.logHalo = std::log(std::max(blob.halo, 1e-3));
    // A lamp is a disc as the lens stretches discs there or, where the halo dominates, round.
    const auto perPixel = directionPerPixel(blob.pixel);
    const Matrix2d stretch = perPixel.transpose() * perPixel;
    candidate.roundness =
        std::min(1.0, roundnessOf(blob.moments) / std::max(0.1, roundnessOf(stretch)));
    candidate.blob = std::move(blob);
    candidates.push_back(std::move(candidate));
  }
  return candidates;
}

Track* LampTracker::State::find(int id) {
  const auto found =
      std::find_if(tracks.begin(), tracks.end(), [&](const Track& t) { return t.id == id; });
  return id == 0 || found == tracks.end() ? nullptr : &*found;
}

void LampTracker::State::forgetLamp() {
  lamp = 0;
  flux = {};
  halo = {};
  mirrors.clear();
  strongerRival = 0;
  for (Track& track : tracks) {
    track.reflection = false;
    track.besideLamp = 0;
  }
}

// Greedy nearest neighbours around each track's constant-velocity prediction.
void LampTracker::State::associate(const std::vector<Candidate>& candidates, TimePoint time) {
  struct Pair {
    double distance;
    std::size_t track;
    int candidate;
  };
  std::vector<Pair> pairs;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    Track& track = tracks[t];
    track.candidate = -1;
    const double dt = toSeconds(time - track.time);
    const Vector3d predicted = (track.direction + track.velocity * dt).normalized();
    const double unknown =
        track.hits < 2 ? kFastestHand * dt
                       : 0.3 * track.velocity.norm() * dt + 0.5 * kGateAcceleration * dt * dt;
    const double gate = std::min(kGateSlack.radians() + unknown, kWidestGate.radians());
    for (std::size_t c = 0; c < candidates.size(); ++c) {
      const double distance = angleBetween(predicted, candidates[c].direction).radians();
      const double change = std::abs(candidates[c].logFlux - track.logFlux);
      if (distance < gate && change < 1.5) {
        pairs.push_back({distance / gate + change, t, static_cast<int>(c)});
      }
    }
  }
  std::sort(pairs.begin(), pairs.end(),
            [](const Pair& a, const Pair& b) { return a.distance < b.distance; });
  std::vector<bool> taken(candidates.size());
  for (const Pair& pair : pairs) {
    Track& track = tracks[pair.track];
    const auto c = static_cast<std::size_t>(pair.candidate);
    if (track.candidate >= 0 || taken[c]) continue;
    taken[c] = true;
    track.candidate = pair.candidate;
    const Candidate& seen = candidates[c];
    const double dt = std::max(toSeconds(time - track.time), 1e-4);
    const Vector3d velocity = (seen.direction - track.direction) / dt;
    track.velocity = track.hits < 2 ? velocity : Vector3d(0.3 * track.velocity + 0.7 * velocity);
    track.direction = seen.direction;
    track.logFlux = seen.logFlux;
    track.time = time;
    track.hits += 1;
    track.proven += 1;
    track.travelled =
        std::max(track.travelled, angleBetween(track.birth, seen.direction).radians());
    track.travelledPixels =
        std::max(track.travelledPixels, (track.birthPixel - seen.blob.pixel).norm());
  }
  std::erase_if(tracks, [&](const Track& track) {
    return track.candidate < 0 && toSeconds(time - track.time) > kTrackLifetime;
  });
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    if (taken[c]) continue;
    Track track;
    track.id = nextId++;
    track.direction = track.birth = candidates[c].direction;
    track.birthPixel = candidates[c].blob.pixel;
    track.time = time;
    track.hits = track.proven = 1;
    track.logFlux = candidates[c].logFlux;
    track.candidate = static_cast<int>(c);
    tracks.push_back(track);
  }
}

std::string LampTracker::State::badPlace(const Candidate& candidate) const {
  const Blob& blob = candidate.blob;
  if (blob.staticFraction > 0.02) return "in front of a light of the room";
  if (blob.cut) return "cut by the border of the picture";
  // The rim of the lens' valid field cuts the spot as well.
  const Vector2d outward =
      (blob.pixel - Vector2d(model->width() / 2.0, model->height() / 2.0)).normalized();
  const double reach = 1.5 * std::sqrt(outward.dot(blob.moments * outward));  // a disc's edge: 2
  if (!model->unproject(blob.pixel + reach * outward)) {
    return "at the rim of the field of view";
  }
  if (blob.crowded) return "touching another bright spot";
  return {};
}

std::string LampTracker::State::objection(const Track& track, const Candidate& candidate,
                                          double smearPixels) const {
  const Blob& blob = candidate.blob;
  if (candidate.roundness < kRoundness && smearPixels < 0.5 * std::sqrt(blob.moments.trace())) {
    return "partly covered";
  }
  if (track.id == lamp) {
    const double step = residualOf(candidate) - track.residual;
    if (step < -kStepTolerance) return "partly covered";
    if (step > kStepTolerance) return "suddenly brighter";
  }
  if (flux.count() > 0) {
    const double base = track.id == lamp ? kTrackedTolerance : kModelTolerance;
    const double tolerance = base + flux.sigma(candidate.direction);
    const double haloTolerance = base + halo.sigma(candidate.direction);
    const double more = candidate.logFlux - flux.predict(candidate.direction);
    const double moreHalo = candidate.logHalo - halo.predict(candidate.direction);
    if (more < -tolerance || moreHalo < -haloTolerance) return "dimmer than the lamp";
    if (more > tolerance || moreHalo > haloTolerance) return "brighter than the lamp";
  }
  return {};
}

// A hand that starts or turns quickly leaves its track's gate. A spot that is as bright as the lamp
// was a moment ago, and near, goes on without proof.
bool LampTracker::State::resumes(const Track& track, const Candidate& candidate) {
  const Track* last = find(lamp);
  return last != nullptr && toSeconds(track.time - last->time) < kResumeSeconds &&
         angleBetween(last->direction, candidate.direction) < kResumeAngle &&
         std::abs(residualOf(candidate) - last->residual) < kResumeTolerance &&
         std::abs(candidate.logHalo - halo.predict(candidate.direction)) < kResumeTolerance &&
         !nearMirror(candidate.blob.pixel);
}

// A track that may be the lamp, when there is none.
Track* LampTracker::State::acquire(const std::vector<Candidate>& candidates, std::string& reason) {
  Track* best = nullptr;
  double strongest = -std::numeric_limits<double>::infinity();
  double second = strongest;
  for (Track& track : tracks) {
    if (track.candidate < 0) continue;
    const double strength = candidates[static_cast<std::size_t>(track.candidate)].strength();
    if (strength > strongest) {
      second = strongest;
      strongest = strength;
      best = &track;
    } else {
      second = std::max(second, strength);
    }
  }
  if (best == nullptr) return nullptr;
  const Candidate& candidate = candidates[static_cast<std::size_t>(best->candidate)];
  std::string against = badPlace(candidate);
  if (against.empty()) against = objection(*best, candidate, 0);
  brighterThanEver = against == "brighter than the lamp" ? brighterThanEver + 1 : 0;
  // Where reflections were seen before, only full brightness for a while is proof.
  const bool mirror = nearMirror(candidate.blob.pixel) &&
                      (best->proven < kHitsBeforeMirror ||
                       candidate.logHalo < halo.predict(candidate.direction) - kMirrorTolerance);
  if (best->reflection || mirror) {
    reason = "only a reflection is visible";
  } else if (second > strongest - kClearlyStronger) {
    reason = "two bright spots of similar strength";
  } else if (!against.empty()) {
    reason = against;
    // Neither a reflection of the lamp nor, since it roams, a light of the room.
    if (brighterThanEver > 25 && best->travelled > Angle::degrees(5).radians()) forgetLamp();
  } else if (!resumes(*best, candidate) &&
             (best->proven < (flux.count() > 0 ? kHitsToReacquire : kHitsToAcquire) ||
              best->travelledPixels < kHandTremorPixels)) {
    reason = "not yet sure of the lamp";
  } else {
    return best;
  }
  return nullptr;
}

LampObservation LampTracker::State::observe(const Track& track, const Candidate& candidate,
                                            const std::vector<Candidate>& all,
                                            const FrameMetadata& metadata,
                                            double smearPixels) const {
  LampObservation seen;
  seen.time = metadata.midExposure;
  seen.pixel = candidate.blob.pixel;
  seen.spreadPixels = std::sqrt(candidate.blob.moments.trace());
  seen.flux = candidate.blob.flux;
  seen.directionInSource = candidate.direction;
  seen.originInSource = model->rayOrigin(candidate.direction);

  // Noise; a twentieth of the spot's size, for what a saturated core hides; as much of the size as
  // the brightness deviates, for a lamp covered a little; and the motion while the shutter was
  // open.
  const double deviation = std::abs(residualOf(candidate) - track.residual);
  const double hidden = seen.spreadPixels * (0.05 + 0.5 * deviation);
  seen.covariance = candidate.blob.centroidCovariance +
                    (hidden * hidden + smearPixels * smearPixels / 12) * Matrix2d::Identity();
  const auto perPixel = directionPerPixel(seen.pixel);
  const Matrix3d covariance = perPixel * seen.covariance * perPixel.transpose();
  const Matrix3d tangent =
      Matrix3d::Identity() - candidate.direction * candidate.direction.transpose();
  seen.directionCovariance = tangent * covariance * tangent;
  seen.directionCovariance += model->directionCovariance(candidate.direction);
  seen.beyondCalibration = !model->covers(candidate.direction);

  double rival = -3;
  for (const Candidate& other : all) {
    if (&other != &candidate) rival = std::max(rival, other.strength() - candidate.strength());
  }
  const double sigma = flux.count() > 0 ? flux.sigma(candidate.direction) : 0.3;
  const double away = flux.count() > 0 ? residualOf(candidate) / (2 * sigma) : 0;
  seen.confidence = std::exp(-0.5 * away * away) * std::exp(-8 * deviation * deviation) *
                    std::min(1.0, track.proven / 6.0) *
                    std::clamp(1.3 - std::exp(rival), 0.1, 1.0) *
                    std::min(1.0, candidate.roundness / 0.9);
  return seen;
}

TrackResult LampTracker::State::judge(const std::vector<Candidate>& candidates,
                                      const FrameMetadata& metadata) {
  associate(candidates, metadata.midExposure);
  const auto none = [&](TrackState state, std::string reason) {
    return TrackResult{state, std::nullopt, std::move(reason)};
  };
  Track* track = find(lamp);
  if (track == nullptr || track->candidate < 0) {
    if (candidates.empty()) return none(TrackState::kLost, "no lamp in view");
    std::string reason;
    track = acquire(candidates, reason);
    if (track == nullptr) return none(TrackState::kAmbiguous, std::move(reason));
    lamp = track->id;
    track->residual = residualOf(candidates[static_cast<std::size_t>(track->candidate)]);
  }
  const Candidate& candidate = candidates[static_cast<std::size_t>(track->candidate)];

  if (std::string against = badPlace(candidate); !against.empty()) {
    // A short passage leaves the track its standing: its brightness must fit when it comes out.
    if (toSeconds(metadata.midExposure - track->accepted) > kPassageSeconds)
      lamp = track->proven = 0;
    return none(TrackState::kLost, std::move(against));
  }

  const double pixelsPerRadian =
      1 / std::max(1e-9, directionPerPixel(candidate.blob.pixel).norm() / std::sqrt(2.0));
  const double smear = track->velocity.norm() * metadata.exposureSeconds * pixelsPerRadian;
  if (std::string against = objection(*track, candidate, smear); !against.empty()) {
    // From here on it has to prove itself anew.
    lamp = track->proven = 0;
    return none(TrackState::kLost, std::move(against));
  }

  // Others that are lit as well: the lamp is the one with the unbroken track, if they are apart.
  bool outshone = false;
  for (Track& other : tracks) {
    if (&other == track || other.candidate < 0) continue;
    const Candidate& rival = candidates[static_cast<std::size_t>(other.candidate)];
    if (rival.strength() > candidate.strength() + kClearlyStronger) outshone = true;
  }
  strongerRival = outshone ? strongerRival + 1 : 0;
  if (outshone) {
    // Either a new light of the room, or what was followed so far was the reflection.
    if (strongerRival >= 3) {
      lamp = 0;
      if (flux.count() < kModelTrusted) forgetLamp();
    }
    return none(TrackState::kAmbiguous, "something brighter than the lamp appeared");
  }
  for (Track& other : tracks) {
    if (&other == track || other.candidate < 0) continue;
    const Candidate& rival = candidates[static_cast<std::size_t>(other.candidate)];
    const double apart = angleBetween(rival.direction, candidate.direction).radians();
    const bool similar = rival.strength() > candidate.strength() - 2 * kClearlyStronger;
    if (similar && !other.reflection && apart < Angle::degrees(8).radians()) {
      return none(TrackState::kAmbiguous, "a reflection close to the lamp");
    }
    other.besideLamp += 1;
    if (other.besideLamp >= 3 || apart > Angle::degrees(4).radians()) {
      other.reflection = true;
      mirrors.insert(mirrorCell(rival.blob.pixel));
    }
  }

  const LampObservation seen = observe(*track, candidate, candidates, metadata, smear);
  track->accepted = metadata.midExposure;
  track->residual += 0.3 * (residualOf(candidate) - track->residual);
  flux.add(candidate.direction, candidate.logFlux);
  halo.add(candidate.direction, candidate.logHalo);
  trail.push_back(seen);
  while (trail.size() > options.trailLength) trail.pop_front();
  return {TrackState::kTracking, seen, {}};
}

LampTracker::LampTracker(std::shared_ptr<const CameraModel> model, LampTrackerOptions options)
    : state_(std::make_unique<State>()) {
  state_->model = std::move(model);
  state_->options = std::move(options);
}
LampTracker::~LampTracker() = default;
LampTracker::LampTracker(LampTracker&&) noexcept = default;
LampTracker& LampTracker::operator=(LampTracker&&) noexcept = default;

Result<void> LampTracker::learnBackground(const Frame& frame) {
  ASSIGN_OR_RETURN(auto counts, state_->read(frame));
  state_->background.learn(std::move(counts));
  return {};
}

Result<TrackResult> LampTracker::track(const Frame& frame) {
  State& s = *state_;
  ASSIGN_OR_RETURN(auto counts, s.read(frame));
  if (!s.background.ready()) {
    if (s.background.learned() < kFewestLearned) s.teachItself = true;
    if (s.teachItself) {
      s.background.learn(std::move(counts));
      if (s.background.learned() == kLearnFromTracking) s.background.finish();
      return TrackResult{TrackState::kLearning, std::nullopt, "learning the lights of the room"};
    }
    s.background.finish();
  }
  const std::vector<Candidate> candidates = s.candidatesIn(counts);
  std::vector<Region> bright;
  for (const Candidate& candidate : candidates) bright.push_back(candidate.blob.window);
  s.background.adapt(counts, bright);
  return s.judge(candidates, frame.metadata);
}

const std::deque<LampObservation>& LampTracker::trail() const { return state_->trail; }

}  // namespace lightsketch
