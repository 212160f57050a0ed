// Small things that many pages are made of.
#pragma once

#include <QAbstractButton>
#include <QLabel>
#include <QProgressBar>

#include "ui/app/task.h"

namespace lightsketch {

// Its underlined letter leads to `buddy`.
inline QLabel* labelFor(QWidget* buddy, const QString& text) {
  auto* label = new QLabel(text);
  label->setBuddy(buddy);
  return label;
}

// Grey words that explain.
inline QLabel* explained(const QString& text) {
  auto* label = new QLabel(text);
  label->setWordWrap(true);
  label->setForegroundRole(QPalette::PlaceholderText);
  return label;
}

inline void enlarge(QWidget* widget, double factor, bool bold = false) {
  QFont font = widget->font();
  font.setPointSizeF(font.pointSizeF() * factor);
  font.setBold(bold);
  widget->setFont(font);
}

// One of a row of which one is down.
inline void makeChoice(QAbstractButton* button) {
  button->setCheckable(true);
  button->setMinimumHeight(30);
  button->setStyleSheet(
      "QAbstractButton { border: none; border-radius: 3px; padding: 0 4px;"
      " background: palette(button); }"
      "QAbstractButton:hover { background: palette(midlight); }"
      "QAbstractButton:focus { border: 1px solid palette(highlight); }"
      "QAbstractButton:checked { background: palette(highlight); color: palette(highlighted-text); "
      "}"
      "QAbstractButton:disabled { color: palette(mid); }");
}

// Shows how far the task is, until it ends.
inline void follow(const Task* task, QProgressBar* bar) {
  bar->setRange(0, 0);
  bar->setFormat({});
  bar->show();
  QObject::connect(task, &Task::progressed, bar,
                   [bar](const QString& stage, double fraction, double) {
                     bar->setRange(0, fraction < 0 ? 0 : 1000);
                     if (fraction >= 0) bar->setValue(qRound(1000 * fraction));
                     bar->setFormat(stage);
                   });
  QObject::connect(task, &Task::finished, bar, &QWidget::hide);
}

}  // namespace lightsketch
