#include "ui/app/validate_page.h"

namespace lightsketch {

ValidatePage::ValidatePage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString ValidatePage::purpose() const { return {}; }
void ValidatePage::entered() {}
void ValidatePage::left() {}

}  // namespace lightsketch
