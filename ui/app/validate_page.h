#pragma once

#include "ui/app/page.h"

namespace lightsketch {

class ValidatePage final : public Page {
  Q_OBJECT
 public:
  explicit ValidatePage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Validate"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
};

}  // namespace lightsketch
