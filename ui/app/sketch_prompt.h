// What the person with the lamp reads from three metres: how much is done, where to go, what is
// wrong.
#pragma once

#include <QPointF>
#include <QString>
#include <QWidget>
#include <optional>

#include "capture/session/recorder.h"

namespace lightsketch {

// How to speak of a refusal.
struct RefusalWords {
  QString shout;   // "Slower"; empty: part of normal work, nothing to be told
  QString name;    // "Lamp too fast"
  QString lesson;  // "Move about half as fast, or ..."
};
RefusalWords wordsFor(Refusal refusal);

class SketchPrompt final : public QWidget {
  Q_OBJECT
 public:
  enum class Mood { kCalm, kGood, kTrouble };
  struct Content {
    double coverage = 0;  // of the wanted directions
    double goal = 1;
    QString word;
    QString detail;
    Mood mood = Mood::kCalm;
    // Where to go from the lamp, on the screen, any length but 0; and whether it is there already.
    std::optional<QPointF> arrow;
    bool there = false;
    QString rate;  // "84"; empty: not said
    QString left;  // "2:10"
    bool operator==(const Content&) const = default;
  };

  explicit SketchPrompt(QWidget* parent = nullptr);
  void setContent(const Content& content);
  const Content& content() const { return content_; }

  QSize sizeHint() const override { return {900, 136}; }
  QSize minimumSizeHint() const override { return {600, 110}; }

 protected:
  void paintEvent(QPaintEvent* event) override;

 private:
  QRect percentArea() const;
  QRect arrowArea() const;
  QRect wordArea() const;
  QRect figuresArea() const;
  void paintPercent(QPainter& painter) const;
  void paintArrow(QPainter& painter) const;
  void paintWords(QPainter& painter) const;
  void paintFigures(QPainter& painter) const;

  Content content_;
};

}  // namespace lightsketch
