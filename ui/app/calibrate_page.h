#pragma once

#include "ui/app/page.h"

class QTabWidget;

namespace lightsketch {

class BoardBox;

// Lens, poses and response, guided.
class CalibratePage final : public Page {
  Q_OBJECT
 public:
  explicit CalibratePage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Calibrate"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
  void begin() override;

 private:
  QTabWidget* steps_;
};

}  // namespace lightsketch
