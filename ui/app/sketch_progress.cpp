#include "ui/app/sketch_progress.h"

#include <QObject>
#include <algorithm>
#include <cmath>

#include "capture/frame/direction.h"

namespace lightsketch {
namespace {

constexpr double kGoodSeconds = 0.25;  // that a kept frame is shown
constexpr double kThereDegrees = 3;    // nearer than this there is no arrow

QString minutes(double seconds) {
  const int whole = static_cast<int>(std::ceil(seconds));
  return QString("%1:%2").arg(whole / 60).arg(whole % 60, 2, 10, QChar('0'));
}

}  // namespace

SketchPrompt::Content SketchProgress::prompt(int directions,
                                             const HemisphereView& hemisphere) const {
  const TimePoint now = Clock::now();
  SketchPrompt::Content content;
  content.coverage = state.coverage;
  content.goal = job.recorder.coverageGoal;
  if (!state.waitingFor.empty()) {
    content.word = QObject::tr("Camera lost");
    content.detail = QObject::tr(
        "Everything so far is kept. Look after its cable and power; the recording goes on by "
        "itself.");
    content.mood = SketchPrompt::Mood::kTrouble;
    return content;
  }
  if (!state.grid) {
    content.word = QObject::tr("One moment");
    content.detail =
        QObject::tr("The cameras are being opened. Have the lamp at hand, switched off.");
    return content;
  }
  if (state.paused) {
    content.word = QObject::tr("Paused");
    content.detail =
        QObject::tr("Space goes on. Drag a circle on the hemisphere to delete and shoot again.");
    return content;
  }
  if (state.lampWantedOff) {
    const double left = job.recorder.ambientSeconds - toSeconds(now - ambientSince.value_or(now));
    content.word = QObject::tr("Lamp off, please");
    content.detail =
        left > 0
            ? QObject::tr("The room's own light is measured: %1 s").arg(left, 0, 'f', 1)
            : QObject::tr("The room's own light is measured, as soon as it is as dark as it gets.");
    return content;
  }
  content.rate = QString::number(qRound(pace.keptPerMinute(now)));
  content.left = timeLeft(directions);
  if (const auto refusal = pace.trouble(now)) {
    const RefusalWords words = wordsFor(*refusal);
    content.word = words.shout;
    content.detail =
        *refusal == Refusal::kLampNotSeen && !state.lampTrouble.empty()
            ? QObject::tr("%1. %2").arg(QString::fromStdString(state.lampTrouble), words.lesson)
            : words.lesson;
    content.mood = SketchPrompt::Mood::kTrouble;
  }
  if (state.nextDirection && state.lampDirection) {
    const double away = angleBetween(*state.lampDirection, *state.nextDirection).degrees();
    content.there = away < kThereDegrees;
    if (!content.there) {
      content.arrow =
          hemisphere.project(*state.nextDirection) - hemisphere.project(*state.lampDirection);
    }
    if (content.word.isEmpty()) {
      content.word = !job.recorder.bracket.empty() && content.there
                         ? QObject::tr("Hold still")
                         : QObject::tr("Follow the arrow");
      content.detail = QObject::tr("%1\u00b0 to the next gap. Lamp known to \u00b1%2\u00b0.")
                           .arg(qRound(away))
                           .arg(state.directionSigma.degrees(), 0, 'f', 1);
    }
  } else if (content.word.isEmpty()) {
    content.word = QObject::tr("Lamp on");
    content.detail = state.lampTrouble.empty()
                         ? QObject::tr("Hold it up so that the source camera sees it.")
                         : QString::fromStdString(state.lampTrouble);
  }
  if (content.mood == SketchPrompt::Mood::kCalm && pace.keptWithin(now, kGoodSeconds)) {
    content.mood = SketchPrompt::Mood::kGood;
  }
  return content;
}

QString SketchProgress::timeLeft(int directions) const {
  const TimePoint now = Clock::now();
  const double missing = (job.recorder.coverageGoal - state.coverage) * directions;
  const double perMinute = pace.keptPerMinute(now);
  std::optional<double> seconds;
  if (perMinute > 0.5) seconds = std::max(0.0, 60 * missing / perMinute);
  if (job.recorder.timeLimitSeconds) {
    const double limit = std::max(0.0, *job.recorder.timeLimitSeconds - toSeconds(now - begun));
    seconds = std::min(seconds.value_or(limit), limit);
  }
  return seconds ? minutes(*seconds) : QString();
}

}  // namespace lightsketch
