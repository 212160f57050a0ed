#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class CalibratePage final : public Page {
  Q_OBJECT
 public:
  explicit CalibratePage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Calibrate"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
