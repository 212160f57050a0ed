#include "ui/app/theme.h"

#include <QApplication>
#include <QPalette>
#include <QStyleFactory>
#include <QWidget>

namespace lightsketch {

void applyTheme(const QString& name) {
  QApplication::setStyle(QStyleFactory::create("Fusion"));
  const bool dark = name != "light";
  const auto grey = [&](int onDark, int onLight) {
    const int level = dark ? onDark : onLight;
    return QColor(level, level, level);
  };
  QPalette palette;
  palette.setColor(QPalette::Window, grey(42, 238));
  palette.setColor(QPalette::WindowText, grey(225, 25));
  palette.setColor(QPalette::Base, grey(28, 255));
  palette.setColor(QPalette::AlternateBase, grey(36, 245));
  palette.setColor(QPalette::Text, grey(225, 25));
  palette.setColor(QPalette::Button, grey(58, 228));
  palette.setColor(QPalette::ButtonText, grey(230, 20));
  palette.setColor(QPalette::BrightText, QColor(255, 90, 80));
  palette.setColor(QPalette::Light, grey(80, 255));
  palette.setColor(QPalette::Midlight, grey(66, 246));
  palette.setColor(QPalette::Mid, grey(96, 170));
  palette.setColor(QPalette::Dark, grey(20, 60));
  palette.setColor(QPalette::Shadow, grey(8, 90));
  palette.setColor(QPalette::Highlight, QColor(255, 168, 38));  // the lamp's
  palette.setColor(QPalette::HighlightedText, QColor(20, 20, 20));
  palette.setColor(QPalette::Link, dark ? QColor(120, 180, 255) : QColor(20, 90, 200));
  palette.setColor(QPalette::ToolTipBase, grey(64, 255));
  palette.setColor(QPalette::ToolTipText, grey(235, 20));
  palette.setColor(QPalette::PlaceholderText, grey(140, 130));
  for (const auto role : {QPalette::WindowText, QPalette::Text, QPalette::ButtonText}) {
    palette.setColor(QPalette::Disabled, role, grey(120, 150));
  }
  QApplication::setPalette(palette);
  // Style sheets keep the colours that palette(...) had when they were set.
  for (QWidget* widget : QApplication::allWidgets()) {
    const QString sheet = widget->styleSheet();
    if (sheet.isEmpty()) continue;
    widget->setStyleSheet({});
    widget->setStyleSheet(sheet);
  }
}

}  // namespace lightsketch
