#include "ui/app/sketch_page.h"

namespace lightsketch {

SketchPage::SketchPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {}
QString SketchPage::purpose() const { return {}; }
void SketchPage::entered() {}
void SketchPage::left() {}

}  // namespace lightsketch
