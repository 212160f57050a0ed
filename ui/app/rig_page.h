#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class RigPage final : public Page {
  Q_OBJECT
 public:
  explicit RigPage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Rig"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
