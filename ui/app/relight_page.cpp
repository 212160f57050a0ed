#include "ui/app/relight_page.h"

namespace lightsketch {

RelightPage::RelightPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString RelightPage::purpose() const { return {}; }
void RelightPage::entered() {}
void RelightPage::left() {}

}  // namespace lightsketch
