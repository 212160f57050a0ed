// One page of the window.
#pragma once

#include <QWidget>

namespace lightsketch {

class Workspace;

class Page : public QWidget {
  Q_OBJECT
 public:
  explicit Page(Workspace& workspace, QWidget* parent = nullptr)
      : QWidget(parent), workspace_(workspace) {}

  // "Sketch", for the list at the left, and what one does there, for its tooltip.
  virtual QString title() const = 0;
  virtual QString purpose() const = 0;
  // The page is shown; it is left for another. Pages that use a camera's preview say so to the
  // RigLink here.
  virtual void entered() {}
  virtual void left() {}
  // What its main button does: record, develop, ...
  virtual void begin() {}

 protected:
  Workspace& workspace() const { return workspace_; }

 private:
  Workspace& workspace_;
};

}  // namespace lightsketch
