#include "ui/app/sketch_prompt.h"

#include <QPaintEvent>
#include <QPainter>
#include <algorithm>
#include <cmath>

#include "ui/app/sketch_overlay.h"

namespace lightsketch {
namespace {

QColor colourOf(SketchPrompt::Mood mood, const QPalette& palette) {
  switch (mood) {
    case SketchPrompt::Mood::kCalm:
      return palette.color(QPalette::WindowText);
    case SketchPrompt::Mood::kGood:
      return colourOf(SketchDot::kCaptured);
    case SketchPrompt::Mood::kTrouble:
      return colourOf(SketchDot::kRefused);
  }
  return {};
}

// As large as `pixels`, smaller where the text would not fit.
QFont fitting(QFont font, const QString& text, double pixels, double width) {
  font.setPixelSize(std::max(8, static_cast<int>(pixels)));
  const double wide = QFontMetricsF(font).horizontalAdvance(text);
  if (wide > width) font.setPixelSize(std::max(8, static_cast<int>(pixels * width / wide)));
  return font;
}

}  // namespace

RefusalWords wordsFor(Refusal refusal) {
  const auto words = [](const char* shout, const char* name, const char* lesson) -> RefusalWords {
    return {*shout ? SketchPrompt::tr(shout) : QString(), SketchPrompt::tr(name),
            SketchPrompt::tr(lesson)};
  };
  switch (refusal) {
    case Refusal::kNone:
      return words("", QT_TR_NOOP("Kept"), "");
    case Refusal::kLampNotSeen:
      return words(QT_TR_NOOP("Lamp hidden"), QT_TR_NOOP("Lamp not seen"),
                   QT_TR_NOOP("Keep hand and body out of the line from the lamp to the source "
                              "camera."));
    case Refusal::kLampTooFast:
      return words(QT_TR_NOOP("Slower"), QT_TR_NOOP("Lamp too fast"),
                   QT_TR_NOOP("Move about half as fast, or shorten the exposure on the Rig page."));
    case Refusal::kSaturated:
      return words(QT_TR_NOOP("Too bright"), QT_TR_NOOP("Picture too bright"),
                   QT_TR_NOOP("Hold the lamp further away, or shorten the scene camera's exposure "
                              "on the Rig page."));
    case Refusal::kNotNew:
      return words("", QT_TR_NOOP("Already there"),
                   QT_TR_NOOP("Normal on the way to the next gap."));
    case Refusal::kUnpaired:
      return words(QT_TR_NOOP("Camera late"), QT_TR_NOOP("No source picture at that moment"),
                   QT_TR_NOOP("Look at the link's figures on the Rig page; a lower frame rate "
                              "helps."));
    case Refusal::kOutsideGrid:
      return words(QT_TR_NOOP("Come forward"), QT_TR_NOOP("Lamp behind the subject"),
                   QT_TR_NOOP("Stay on the camera's side of the subject, or choose the whole "
                              "sphere."));
    case Refusal::kBeyondCalibration:
      return words(QT_TR_NOOP("Too far out"), QT_TR_NOOP("Lamp outside the calibrated field"),
                   QT_TR_NOOP("Stay inside the blue outline, or show the board further out on the "
                              "Calibrate page."));
    case Refusal::kUncertain:
      return words(QT_TR_NOOP("Unsure"), QT_TR_NOOP("Direction too uncertain"),
                   QT_TR_NOOP("Hold the lamp further from the source camera; a new calibration of "
                              "the poses helps."));
    case Refusal::kBracketing:
      return words(QT_TR_NOOP("Hold still"), QT_TR_NOOP("Part of a bracket"),
                   QT_TR_NOOP("Normal: several exposures make one frame. Hold still until it "
                              "sounds."));
  }
  return {};
}

SketchPrompt::SketchPrompt(QWidget* parent) : QWidget(parent) {
  setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Fixed);
  setAccessibleName(tr("Guide"));
}

void SketchPrompt::setContent(const Content& content) {
  if (content == content_) return;
  if (content.coverage != content_.coverage || content.goal != content_.goal) {
    update(percentArea());
  }
  if (content.arrow != content_.arrow || content.there != content_.there ||
      content.mood != content_.mood) {
    update(arrowArea());
  }
  if (content.word != content_.word || content.detail != content_.detail ||
      content.mood != content_.mood) {
    update(wordArea());
    setAccessibleDescription(QString("%1. %2").arg(content.word, content.detail));
  }
  if (content.rate != content_.rate || content.left != content_.left) update(figuresArea());
  content_ = content;
}

QRect SketchPrompt::percentArea() const { return {0, 0, height() * 9 / 4, height()}; }
QRect SketchPrompt::arrowArea() const { return {percentArea().right(), 0, height(), height()}; }
QRect SketchPrompt::figuresArea() const {
  const int wide = height() * 3 / 2;
  return {width() - wide, 0, wide, height()};
}
QRect SketchPrompt::wordArea() const {
  const int from = arrowArea().right() + height() / 8;
  return {from, 0, std::max(0, figuresArea().left() - from), height()};
}

void SketchPrompt::paintPercent(QPainter& painter) const {
  const QRectF area = percentArea();
  // Never 100 before it is.
  const int percent = static_cast<int>(std::floor(100 * content_.coverage + 1e-9));
  const QString text = tr("%1 %").arg(percent);
  painter.setPen(palette().color(QPalette::WindowText));
  painter.setFont(fitting(font(), text, 0.78 * area.height(), 0.94 * area.width()));
  painter.drawText(area.adjusted(0, 0, 0, -0.14 * area.height()), Qt::AlignCenter, text);
  // How far it is to the goal.
  const QRectF bar(area.left() + 6, area.bottom() - 0.14 * area.height(), area.width() - 12,
                   0.1 * area.height());
  painter.setPen(Qt::NoPen);
  painter.setBrush(palette().color(QPalette::Midlight));
  painter.drawRoundedRect(bar, 3, 3);
  painter.setBrush(lightsketch::colourOf(SketchDot::kCaptured));
  painter.drawRoundedRect(
      QRectF(bar.left(), bar.top(), bar.width() * std::min(1.0, content_.coverage), bar.height()),
      3, 3);
  painter.setBrush(palette().color(QPalette::WindowText));
  painter.drawRect(
      QRectF(bar.left() + content_.goal * bar.width() - 1.5, bar.top() - 3, 3, bar.height() + 6));
}

void SketchPrompt::paintArrow(QPainter& painter) const {
  const QRectF area = arrowArea();
  const double size = 0.42 * area.height();
  const QColor colour = content_.mood == Mood::kGood ? lightsketch::colourOf(SketchDot::kCaptured)
                                                     : palette().color(QPalette::Highlight);
  painter.save();
  painter.translate(area.center());
  if (content_.there) {
    painter.setPen(QPen(colour, 0.2 * size));
    painter.setBrush(Qt::NoBrush);
    painter.drawEllipse(QPointF(), 0.6 * size, 0.6 * size);
    painter.setBrush(colour);
    painter.drawEllipse(QPointF(), 0.15 * size, 0.15 * size);
  } else if (content_.arrow) {
    painter.rotate(std::atan2(content_.arrow->y(), content_.arrow->x()) * 180 / M_PI);
    painter.setPen(Qt::NoPen);
    painter.setBrush(colour);
    painter.drawPolygon(QPolygonF({{size, 0},
                                   {0.05 * size, -0.85 * size},
                                   {0.05 * size, -0.32 * size},
                                   {-size, -0.32 * size},
                                   {-size, 0.32 * size},
                                   {0.05 * size, 0.32 * size},
                                   {0.05 * size, 0.85 * size}}));
  }
  painter.restore();
}

void SketchPrompt::paintWords(QPainter& painter) const {
  const QRectF area = wordArea();
  painter.setPen(colourOf(content_.mood, palette()));
  painter.setFont(fitting(font(), content_.word, 0.46 * area.height(), area.width()));
  painter.drawText(area.adjusted(0, 0.06 * area.height(), 0, -0.38 * area.height()),
                   Qt::AlignLeft | Qt::AlignVCenter, content_.word);
  painter.setPen(palette().color(QPalette::WindowText));
  QFont small = font();
  small.setPixelSize(std::max(12, static_cast<int>(0.15 * area.height())));
  painter.setFont(small);
  painter.drawText(area.adjusted(0, 0.62 * area.height(), 0, 0),
                   Qt::AlignLeft | Qt::AlignTop | Qt::TextWordWrap, content_.detail);
}

void SketchPrompt::paintFigures(QPainter& painter) const {
  const QRectF area = figuresArea();
  const auto figure = [&](const QRectF& at, const QString& value, const QString& label) {
    if (value.isEmpty()) return;
    painter.setPen(palette().color(QPalette::WindowText));
    painter.setFont(fitting(font(), value, 0.66 * at.height(), at.width()));
    painter.drawText(at.adjusted(0, 0, 0, -0.3 * at.height()), Qt::AlignRight | Qt::AlignVCenter,
                     value);
    painter.setPen(palette().color(QPalette::PlaceholderText));
    painter.setFont(fitting(font(), label, 0.22 * at.height(), at.width()));
    painter.drawText(at.adjusted(0, 0.7 * at.height(), 0, 0), Qt::AlignRight | Qt::AlignTop, label);
  };
  const QRectF upper = area.adjusted(0, 0, -4, -0.5 * area.height());
  figure(upper, content_.rate, tr("kept a minute"));
  figure(upper.translated(0, 0.5 * area.height()), content_.left, tr("left"));
}

void SketchPrompt::paintEvent(QPaintEvent* event) {
  QPainter painter(this);
  painter.setRenderHint(QPainter::Antialiasing);
  const auto part = [&](const QRect& area, void (SketchPrompt::*paint)(QPainter&) const) {
    if (event->region().intersects(area)) (this->*paint)(painter);
  };
  part(percentArea(), &SketchPrompt::paintPercent);
  part(arrowArea(), &SketchPrompt::paintArrow);
  part(wordArea(), &SketchPrompt::paintWords);
  part(figuresArea(), &SketchPrompt::paintFigures);
}

}  // namespace lightsketch
