#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class SketchPage final : public Page {
  Q_OBJECT
 public:
  explicit SketchPage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Sketch"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
