#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class RelightPage final : public Page {
  Q_OBJECT
 public:
  explicit RelightPage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Relight"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
