#include "ui/app/rig_page.h"

namespace lightsketch {

RigPage::RigPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString RigPage::purpose() const { return {}; }
void RigPage::entered() {}
void RigPage::left() {}

}  // namespace lightsketch
