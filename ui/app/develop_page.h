#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class DevelopPage final : public Page {
  Q_OBJECT
 public:
  explicit DevelopPage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Develop"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
