#include "ui/app/calibrate_page.h"

namespace lightsketch {

CalibratePage::CalibratePage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString CalibratePage::purpose() const { return {}; }
void CalibratePage::entered() {}
void CalibratePage::left() {}

}  // namespace lightsketch
