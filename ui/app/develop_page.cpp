#include "ui/app/develop_page.h"

namespace lightsketch {

DevelopPage::DevelopPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString DevelopPage::purpose() const { return {}; }
void DevelopPage::entered() {}
void DevelopPage::left() {}

}  // namespace lightsketch
