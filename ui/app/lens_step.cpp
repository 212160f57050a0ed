#include "ui/app/lens_step.h"

#include <QComboBox>
#include <QFormLayout>
#include <QHBoxLayout>
#include <QLabel>
#include <QPainter>
#include <QPushButton>
#include <QSpinBox>
#include <QStackedWidget>
#include <QVBoxLayout>

#include "pipeline/job/calibrate_jobs.h"
#include "ui/app/board_box.h"
#include "ui/app/controls.h"
#include "ui/app/frame_view.h"
#include "ui/app/uncertainty_map.h"
#include "ui/app/use_calibration.h"

namespace lightsketch {
namespace {

enum Choice { kSource, kScene };

QString listOf(const Json& figures, const char* name) {
  QString items;
  for (const Json& item : figures.value(name, Json::array())) {
    items += "<li>" + QString::fromStdString(item.get<std::string>()).toHtmlEscaped() + "</li>";
  }
  return items;
}

}  // namespace

QString inWords(ViewVerdict verdict, int count, int wanted) {
  switch (verdict) {
    case ViewVerdict::kKeep:
      return LensStep::tr("New view: %1 of %2").arg(count).arg(wanted);
    case ViewVerdict::kMoving:
      return LensStep::tr("Hold it still");
    case ViewVerdict::kNotNew:
      return LensStep::tr("Seen: move, turn or tilt it");
    case ViewVerdict::kNoBoard:
      return LensStep::tr("No board in view");
  }
  return {};
}

QString describeLens(const Json& figures) {
  const Json& split = figures["splitHalf"];
  const Json& field = figures["coveredFieldDegrees"];
  QString text = LensStep::tr("%1 views, %2 corners; residual <b>%3 px</b>")
                     .arg(figures["viewsUsed"].get<int>())
                     .arg(figures["cornersUsed"].get<int>())
                     .arg(figures["residualPixels"].get<double>(), 0, 'f', 3) +
                 "<br>" +
                 LensStep::tr("covered %1 to %2 degrees off axis, by azimuth")
                     .arg(field[0].get<double>(), 0, 'f', 0)
                     .arg(field[1].get<double>(), 0, 'f', 0);
  if (split["splits"].get<int>() > 0 && split["rmsDegrees"].is_number()) {
    text +=
        "<br>" + LensStep::tr("halves of the views differ by <b>%1\u00b0</b> (%2\u00b0 predicted)")
                     .arg(split["rmsDegrees"].get<double>(), 0, 'g', 2)
                     .arg(split["predictedDegrees"].get<double>(), 0, 'g', 2);
  }
  return text;
}

QString adviceOn(const Json& figures) {
  const QString items = listOf(figures, "warnings") + listOf(figures, "advice");
  if (items.isEmpty()) return LensStep::tr("Nothing is left to improve.");
  return LensStep::tr("To make it better:") + "<ul style=\"margin: 0 0 0 -22px\">" + items +
         "</ul>";
}

void BoardGuide::follow(const LiveViewState& state, std::size_t camera) {
  corners = state.corners[camera];
  const auto [width, height] = state.sizes[camera];
  if (kept != state.kept[camera]) {
    kept = state.kept[camera];
    coverage = FieldCoverage(*kept, {width, height});
  }
  std::optional<Eigen::Vector2d> middle;
  if (!corners.empty()) {
    middle = Eigen::Vector2d::Zero();
    for (const auto& corner : corners) *middle += corner / static_cast<double>(corners.size());
  }
  next = coverage.next(middle);
}

void BoardGuide::paint(QPainter& painter, const QTransform& widgetFromFrame) const {
  if (!kept) return;
  painter.setBrush(Qt::NoBrush);
  for (int cell = 0; cell < FieldCoverage::kCells; ++cell) {
    const QPainterPath outline = widgetFromFrame.map(coverage.outline(cell));
    const bool wanted = next == cell;
    if (coverage.covered(cell)) painter.fillPath(outline, QColor(60, 200, 90, 60));
    if (wanted) painter.fillPath(outline, QColor(255, 168, 38, 70));
    painter.setPen(QPen(wanted ? QColor(255, 168, 38) : QColor(255, 255, 255, 90), wanted ? 2 : 1));
    painter.drawPath(outline);
  }
  const auto dots = [&](const std::vector<Eigen::Vector2d>& points, const QPen& pen) {
    QPolygonF polygon;
    for (const auto& p : points) polygon << widgetFromFrame.map(QPointF(p.x(), p.y()));
    painter.setPen(pen);
    painter.drawPoints(polygon);
  };
  dots(*kept, QPen(QColor(120, 230, 255, 120), 2.5));
  dots(corners, QPen(QColor(255, 60, 200), 6, Qt::SolidLine, Qt::RoundCap));

  // From the board to where it is wanted.
  if (!next || corners.empty()) return;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const auto& corner : corners) middle += corner / static_cast<double>(corners.size());
  const Eigen::Vector2d goal = coverage.centre(*next);
  const QLineF way(widgetFromFrame.map(QPointF(middle.x(), middle.y())),
                   widgetFromFrame.map(QPointF(goal.x(), goal.y())));
  constexpr double kShortest = 20;
  if (way.length() < kShortest) return;
  painter.setPen(QPen(QColor(255, 168, 38), 4, Qt::SolidLine, Qt::RoundCap));
  painter.drawLine(way);
  for (const double turn : {150.0, -150.0}) {
    QLineF barb(way.p2(), way.p1());
    barb.setAngle(way.angle() + turn);
    barb.setLength(16);
    painter.drawLine(barb);
  }
}

LensStep::LensStep(Workspace& workspace, BoardBox& board, QWidget* parent)
    : CalibrationStep(workspace, "calibrateLens", tr("&Start"), parent), board_(board) {
  pictures_ = new QStackedWidget;
  const auto picture = [&](LiveView& view, const QString& name) {
    auto* widget = new FrameView(view);
    widget->setAccessibleName(name);
    widget->setPlaceholder(tr("no picture yet"));
    widget->setOverlay([this](QPainter& painter, const QTransform& widgetFromFrame) {
      if (running()) guide_.paint(painter, widgetFromFrame);
    });
    pictures_->addWidget(widget);
    return widget;
  };
  sourcePicture_ = picture(workspace.rig().sourceView(), tr("Live picture of the source camera"));
  scenePicture_ = picture(workspace.rig().sceneView(), tr("Live picture of the scene camera"));

  auto* form = new QHBoxLayout;
  form->setSpacing(6);
  camera_ = new QComboBox;
  camera_->setObjectName("lensCamera");
  camera_->addItems({tr("Source camera"), tr("Scene camera")});
  camera_->setToolTip(
      tr("Directions to the lamp come from the source camera's lens. The scene "
         "camera's is needed for lamps nearby and for poses."));
  auto* cameraLabel = labelFor(camera_, tr("&Lens of the"));
  views_ = new QSpinBox;
  views_->setObjectName("lensViews");
  views_->setRange(3, 1000);
  views_->setValue(40);
  views_->setToolTip(tr("Views of the board to take; 20 to 40 give a certain result"));
  auto* viewsLabel = labelFor(views_, tr("&from views"));
  for (QWidget* widget :
       std::initializer_list<QWidget*>{cameraLabel, camera_, viewsLabel, views_}) {
    form->addWidget(widget);
  }
  form->addStretch();

  result_ = new QWidget;
  auto* across = new QHBoxLayout(result_);
  across->setContentsMargins(0, 0, 0, 0);
  across->setSpacing(12);
  map_ = new UncertaintyMap;
  map_->setObjectName("uncertainty");
  across->addWidget(map_, 2);
  auto* column = new QVBoxLayout;
  figures_ = new QLabel;
  figures_->setObjectName("lensFigures");
  advice_ = new QLabel;
  advice_->setObjectName("lensAdvice");
  for (QLabel* label : {figures_, advice_}) {
    label->setWordWrap(true);
    label->setTextFormat(Qt::RichText);
    label->setOpenExternalLinks(true);
    label->setTextInteractionFlags(Qt::TextBrowserInteraction);
    column->addWidget(label);
  }
  use_ = new QPushButton(tr("&Use this lens"));
  use_->setObjectName("useLens");
  use_->setToolTip(
      tr("From now on recordings take directions from it; the scene camera's is for sketches under "
         "near lamps (Ctrl+Z goes back)"));
  column->addWidget(use_);
  column->addStretch();
  across->addLayout(column, 3);
  result_->hide();
  arrange(pictures_, form, result_);
  say(tr("Print a board and wave it"),
      tr("Hold it before the camera, close enough to fill a third of the picture, still for a "
         "moment, then somewhere else: tilted, turned, and out to the edge. Views are taken by "
         "themselves."));

  connect(camera_, &QComboBox::currentIndexChanged, this, &LensStep::showCamera);
  connect(use_, &QPushButton::clicked, this, [this] {
    CalibrationFiles files = this->workspace().rig().setup();
    (ofScene() ? files.sceneModel : files.sourceModel) = file_;
    useCalibration(this->workspace(), files);
    use_->setEnabled(false);
    use_->setText(tr("In use"));
  });
}

bool LensStep::ofScene() const { return camera_->currentIndex() == kScene; }

void LensStep::showCamera() {
  result_->hide();  // it is the other camera's
  pictures_->setCurrentWidget(ofScene() ? scenePicture_ : sourcePicture_);
}

void LensStep::begin() {
  RigLink& rig = workspace().rig();
  LensJob job;
  job.camera = ofScene() ? rig.sceneAddress() : rig.sourceAddress();
  job.views = views_->value();
  job.board = board_.board();
  const std::filesystem::path folder = newFolder("lens");
  job.out = folder / (ofScene() ? "scene.json" : "source.json");
  job.report = folder / "report.html";
  const auto field = std::make_shared<FieldUncertainty>();
  guide_ = {};
  if (!run(tr("Lens calibration"), RigProgram::kBoard,
           [job, field](const Cameras& cameras, Progress& progress,
                        std::stop_token stop) -> Result<JobResult> {
             LensJob live = job;
             live.open = cameras.open;
             std::error_code error;
             std::filesystem::create_directories(job.out.parent_path(), error);
             auto result =
                 lensJob(live, progress, std::move(stop),
                         [&](const LiveViewState& state) { cameras.feed.publish(state); });
             if (!result) return result;
             ASSIGN_OR_RETURN(const auto model, loadCameraModel(job.out));
             *field = uncertaintyOf(*model);
             return result;
           })) {
    return;
  }
  file_ = job.out;
  report_ = job.report;
  field_ = field;
  camera_->setEnabled(false);
  result_->hide();
}

void LensStep::told(const LiveViewState& state) {
  guide_.follow(state, 0);
  const QString hint = guide_.next
                           ? tr("Hold the board %1.").arg(FieldCoverage::describe(*guide_.next))
                           : tr("The field is covered; tilt and turn the board.");
  say(inWords(state.verdicts[0], state.counts[0], state.wanted),
      tr("%1 of %2 views, %3 of %4 parts of the field. %5")
          .arg(state.counts[0])
          .arg(state.wanted)
          .arg(guide_.coverage.coveredCells())
          .arg(FieldCoverage::kCells)
          .arg(hint));
}

void LensStep::finished(const Result<JobResult>& result) {
  camera_->setEnabled(true);
  pictures_->currentWidget()->update();
  if (!result) return;
  const Json& figures = result->figures;
  say(tr("The lens is known"));
  map_->setField(*field_);
  figures_->setText(describeLens(figures) + "<br>" + linkTo(report_, tr("Open the report")));
  advice_->setText(adviceOn(figures));
  use_->setEnabled(true);
  use_->setText(tr("&Use this lens"));
  result_->show();
}

}  // namespace lightsketch
