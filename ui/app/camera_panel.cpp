#include "ui/app/camera_panel.h"

#include <QApplication>
#include <QCheckBox>
#include <QDoubleSpinBox>
#include <QGridLayout>
#include <QHBoxLayout>
#include <QKeyEvent>
#include <QLabel>
#include <QMouseEvent>
#include <QPainter>
#include <QProgressBar>
#include <QPushButton>
#include <QSignalBlocker>
#include <QSlider>
#include <QTimer>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

#include "ui/app/controls.h"
#include "ui/app/histogram_view.h"

namespace lightsketch {
namespace {

// The slider's whole steps are hundredths of a decade, from 10 microseconds to a second.
constexpr double kShortestSeconds = 1e-5;
constexpr int kStepsPerDecade = 100;
constexpr int kDecades = 5;
constexpr double kExposuresSeconds = 3;  // that the pairing of the cameras is told from
// While a slider is dragged, the camera is asked ten times a second.
constexpr int kAskMilliseconds = 100;
constexpr int kLeastRegion = 16;  // pixels; anything smaller was a click

int sliderOf(double seconds) {
  return static_cast<int>(std::lround(kStepsPerDecade * std::log10(seconds / kShortestSeconds)));
}
double secondsOf(int slider) {
  return kShortestSeconds * std::pow(10.0, static_cast<double>(slider) / kStepsPerDecade);
}

QDoubleSpinBox* number(const QString& name, const QString& label, const QString& suffix, double low,
                       double high, int decimals) {
  auto* box = new QDoubleSpinBox;
  box->setObjectName(name);
  box->setAccessibleName(label);
  box->setRange(low, high);
  box->setDecimals(decimals);
  box->setSuffix(suffix);
  box->setKeyboardTracking(false);
  return box;
}

// Shows what the camera uses, unless somebody is typing.
template <class Box, class Value>
void display(Box* box, const std::optional<Value>& value) {
  if (!value) return;
  const QSignalBlocker blocker(box);
  box->setValue(*value);
}

}  // namespace

void RegionView::paintEvent(QPaintEvent* event) {
  FrameView::paintEvent(event);
  if (!from_) return;
  QPainter painter(this);
  QColor colour = palette().color(QPalette::Highlight);
  painter.setPen(QPen(colour, 2));
  colour.setAlpha(40);
  painter.setBrush(colour);
  painter.drawRect(QRectF(*from_, to_).normalized());
}

void RegionView::mousePressEvent(QMouseEvent* event) {
  if (event->button() != Qt::LeftButton || !pictureRectangle().contains(event->position())) return;
  from_ = to_ = event->position();
}

void RegionView::mouseMoveEvent(QMouseEvent* event) {
  if (!from_) return;
  to_ = event->position();
  update();
}

void RegionView::mouseReleaseEvent(QMouseEvent* event) {
  if (!from_) return;
  const QRectF drawn = QRectF(*from_, event->position()).normalized() & pictureRectangle();
  from_.reset();
  update();
  const QRect pixels = widgetFromFrame().inverted().mapRect(drawn).toRect();
  if (pixels.width() >= kLeastRegion && pixels.height() >= kLeastRegion) Q_EMIT selected(pixels);
}

void RegionView::keyPressEvent(QKeyEvent* event) {
  if (event->key() != Qt::Key_Escape || !from_) return FrameView::keyPressEvent(event);
  from_.reset();
  update();
}

CameraPanel::CameraPanel(RigLink& rig, bool sceneCamera, QWidget* parent)
    : QWidget(parent), rig_(rig), scene_(sceneCamera) {
  setObjectName(scene_ ? "scenePanel" : "sourcePanel");
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);
  column->setSpacing(4);
  auto* title = new QLabel(scene_ ? tr("<b>Scene camera</b> looks at the subject")
                                  : tr("<b>Source camera</b> watches the lamp"));
  column->addWidget(title);

  picture_ = new RegionView(view());
  picture_->setObjectName("picture");
  picture_->setAccessibleName(scene_ ? tr("Live picture of the scene camera")
                                     : tr("Live picture of the source camera"));
  picture_->setToolTip(tr("Drag a rectangle to read only that part of the sensor"));
  picture_->setPlaceholder(tr("no picture yet"));
  column->addWidget(picture_, 1);

  auto* below = new QHBoxLayout;
  below->setSpacing(12);
  below->addLayout(buildTools());
  below->addLayout(buildSettings(), 1);
  column->addLayout(below);

  answer_ = new QLabel;
  answer_->setObjectName("answer");
  answer_->setWordWrap(true);
  answer_->setToolTip(tr("What the camera really uses, or why it does not do what was asked"));
  column->addWidget(answer_);
  link_ = new QLabel;
  link_->setObjectName("link");
  link_->setMinimumWidth(200);
  link_->setToolTip(
      tr("Lost: frames the camera made that never arrived. Incomplete: arrived with parts missing. "
         "Dropped: no memory was free for them. Any of these in numbers means that the network "
         "cannot carry this rate and region."));
  column->addWidget(link_);

  exposureSoon_ = new QTimer(this);
  exposureSoon_->setSingleShot(true);
  exposureSoon_->setInterval(kAskMilliseconds);
  connect(exposureSoon_, &QTimer::timeout, this, [this] {
    CameraSettings wish;
    wish.exposureSeconds = 1e-3 * exposure_->value();
    configure(wish);
  });
  connect(&view(), &LiveView::pictureReady, this, &CameraPanel::showPicture);
  connect(&rig_, &RigLink::stateChanged, this, &CameraPanel::showUsed);
  connect(&rig_, &RigLink::configured, this, [this](bool scene, const QString& text, bool ok) {
    if (scene != scene_) return;
    showUsed();
    answer_->setText(ok ? tr("Uses %1").arg(text) : text);
    answer_->setForegroundRole(ok ? QPalette::WindowText : QPalette::BrightText);
    sharpest_ = 0;
  });
  showUsed();
  refresh();
}

QLayout* CameraPanel::buildTools() {
  auto* tools = new QVBoxLayout;
  tools->setSpacing(3);
  histogram_ = new HistogramView;
  histogram_->setObjectName("histogram");
  tools->addWidget(histogram_, 1);
  auto* switches = new QHBoxLayout;
  const auto add = [&](const QString& name, const QString& text, const QString& tip) {
    auto* box = new QCheckBox(text);
    box->setObjectName(name);
    box->setToolTip(tip);
    switches->addWidget(box);
    return box;
  };
  auto* logarithmic = add("logarithmic", tr("log"),
                          tr("Stretch small counts, to see a few bright pixels beside many dark "
                             "ones"));
  connect(logarithmic, &QCheckBox::toggled, histogram_, &HistogramView::setLogarithmic);
  saturationOverlay_ = add("saturationOverlay", tr("saturation"),
                           tr("Paint pixels red that are as bright as the sensor can tell"));
  connect(saturationOverlay_, &QCheckBox::toggled, this,
          [this](bool on) { view().setShowSaturation(on); });
  focusOverlay_ = add("focusOverlay", tr("focus"), tr("Paint sharp edges yellow"));
  connect(focusOverlay_, &QCheckBox::toggled, this, [this](bool on) { view().setShowFocus(on); });
  tools->addLayout(switches);
  focus_ = new QProgressBar;
  focus_->setObjectName("focus");
  focus_->setAccessibleName(tr("Focus"));
  focus_->setRange(0, 1000);
  focus_->setMaximumHeight(16);
  focus_->setToolTip(
      tr("How sharp the picture is, against the sharpest since the last change of a setting. Turn "
         "the lens until the bar is full."));
  tools->addWidget(focus_);
  saturated_ = new QLabel;
  saturated_->setObjectName("saturated");
  saturated_->setToolTip(tr("Share of the pixels that are as bright as the sensor can tell"));
  tools->addWidget(saturated_);
  return tools;
}

QLayout* CameraPanel::buildSettings() {
  auto* grid = new QGridLayout;
  grid->setHorizontalSpacing(6);
  grid->setVerticalSpacing(3);
  const auto row = [&](int at, const QString& text, QWidget* buddy) {
    grid->addWidget(labelFor(buddy, text), at, 0);
  };

  exposure_ = number("exposure", tr("Exposure"), tr(" ms"), 0.001, 100'000, 3);
  exposure_->setStepType(QAbstractSpinBox::AdaptiveDecimalStepType);
  exposure_->setMinimumWidth(92);
  exposure_->setToolTip(
      scene_ ? tr("How long each frame gathers light. As long as the brightest parts, lit by the "
                  "lamp, stay just below saturation.")
             : tr("How long each frame gathers light. So short that the room is nearly black and "
                  "the lamp a small dot."));
  exposureSlider_ = new QSlider(Qt::Horizontal);
  exposureSlider_->setObjectName("exposureSlider");
  exposureSlider_->setAccessibleName(tr("Exposure, logarithmic"));
  exposureSlider_->setRange(0, kStepsPerDecade * kDecades);
  exposureSlider_->setPageStep(30);  // twice as long
  exposureSlider_->setToolTip(exposure_->toolTip());
  row(0, tr("E&xposure"), exposure_);
  grid->addWidget(exposureSlider_, 0, 1, 1, 3);
  grid->addWidget(exposure_, 0, 4);
  connect(exposureSlider_, &QSlider::valueChanged, this, [this](int value) {
    const QSignalBlocker blocker(exposure_);
    exposure_->setValue(1e3 * secondsOf(value));
    sendExposureSoon();
  });
  connect(exposure_, &QDoubleSpinBox::valueChanged, this, [this](double milliseconds) {
    const QSignalBlocker blocker(exposureSlider_);
    exposureSlider_->setValue(sliderOf(1e-3 * milliseconds));
    sendExposureSoon();
  });

  gain_ = number("gain", tr("Gain"), tr(" dB"), 0, 60, 1);
  gain_->setToolTip(tr("Amplification. Longer exposure is better: gain makes noise louder too."));
  rate_ = number("rate", tr("Frame rate"), tr(" /s"), 0.1, 1000, 1);
  rate_->setMinimumWidth(70);
  rate_->setToolTip(tr("Frames a second. The camera pauses for a moment when it changes."));
  row(1, tr("&Gain"), gain_);
  grid->addWidget(gain_, 1, 1);
  auto* rateLabel = labelFor(rate_, tr("Fr&ames"));
  rateLabel->setAlignment(Qt::AlignRight | Qt::AlignVCenter);
  grid->addWidget(rateLabel, 1, 2, 1, 2);
  grid->addWidget(rate_, 1, 4);
  connect(gain_, &QDoubleSpinBox::valueChanged, this, [this](double value) {
    CameraSettings wish;
    wish.gainDb = value;
    configure(wish);
  });
  connect(rate_, &QDoubleSpinBox::valueChanged, this, [this](double value) {
    CameraSettings wish;
    wish.framesPerSecond = value;
    configure(wish);
  });

  static const char* const kNames[] = {"regionX", "regionY", "regionWidth", "regionHeight"};
  const QString labels[] = {tr("Left edge of the region"), tr("Top edge of the region"),
                            tr("Width of the region"), tr("Height of the region")};
  const QString prefixes[] = {tr("x "), tr("y "), tr("w "), tr("h ")};
  for (int i = 0; i < 4; ++i) {
    region_[i] = new QSpinBox;
    region_[i]->setObjectName(kNames[i]);
    region_[i]->setAccessibleName(labels[i]);
    region_[i]->setToolTip(tr("%1, in pixels of the sensor").arg(labels[i]));
    region_[i]->setPrefix(prefixes[i]);
    region_[i]->setRange(i < 2 ? 0 : 1, 100'000);
    region_[i]->setKeyboardTracking(false);
    region_[i]->setButtonSymbols(QAbstractSpinBox::NoButtons);
    region_[i]->setMinimumWidth(54);
    grid->addWidget(region_[i], 2, i + 1);
    connect(region_[i], &QSpinBox::valueChanged, this, [this] {
      CameraSettings wish;
      wish.region = Region{region_[0]->value(), region_[1]->value(), region_[2]->value(),
                           region_[3]->value()};
      configure(wish);
    });
  }
  row(2, tr("Re&gion"), region_[0]);
  connect(picture_, &RegionView::selected, this, [this](const QRect& drawn) {
    const auto now = (scene_ ? rig_.sceneSettings() : rig_.sourceSettings()).region;
    if (!now) return;
    // Even numbers: a mosaic keeps its colours, and most sensors only do these.
    CameraSettings wish;
    wish.region = Region{(now->x + drawn.x()) & ~1, (now->y + drawn.y()) & ~1, drawn.width() & ~1,
                         drawn.height() & ~1};
    configure(wish);
  });
  auto* full = new QPushButton(tr("Full frame"));
  full->setObjectName("fullFrame");
  full->setToolTip(tr("Read the whole sensor"));
  connect(full, &QPushButton::clicked, this, [this] {
    CameraSettings wish;
    wish.region = Region{};
    configure(wish);
  });
  grid->addWidget(full, 3, 3, 1, 2);
  grid->setRowStretch(4, 1);
  for (int i = 1; i < 5; ++i) grid->setColumnStretch(i, 1);
  return grid;
}

void CameraPanel::configure(const CameraSettings& settings) {
  if (scene_) {
    rig_.configureScene(settings);
  } else {
    rig_.configureSource(settings);
  }
}

void CameraPanel::sendExposureSoon() {
  if (!exposureSoon_->isActive()) exposureSoon_->start();
}

void CameraPanel::showPicture() {
  const auto picture = view().picture();
  histogram_->setPicture(picture);
  if (!picture) {
    exposures_.clear();
    saturated_->clear();
    focus_->reset();
    focus_->setFormat({});
    return;
  }
  exposures_.push_back(picture->metadata.midExposure);
  while (toSeconds(exposures_.back() - exposures_.front()) > kExposuresSeconds) {
    exposures_.pop_front();
  }
  saturated_->setText(tr("%1 % saturated").arg(100 * picture->saturatedFraction, 0, 'f', 2));
  sharpest_ = std::max(sharpest_, picture->focus);
  focus_->setValue(sharpest_ > 0 ? static_cast<int>(1000 * picture->focus / sharpest_) : 0);
  focus_->setFormat(tr("focus %1").arg(picture->focus, 0, 'g', 3));
}

void CameraPanel::showUsed() {
  const bool live = rig_.state() == RigLink::State::kLive;
  CameraSettings now = live ? (scene_ ? rig_.sceneSettings() : rig_.sourceSettings())
                            : (scene_ ? rig_.setup().scene : rig_.setup().source);
  if (now.exposureSeconds && !exposureSoon_->isActive() && !exposureSlider_->isSliderDown()) {
    display(exposureSlider_, std::optional(sliderOf(*now.exposureSeconds)));
    display(exposure_, std::optional(1e3 * *now.exposureSeconds));
  }
  display(gain_, now.gainDb);
  display(rate_, now.framesPerSecond);
  if (now.region && now.region->width > 0) {
    const int values[] = {now.region->x, now.region->y, now.region->width, now.region->height};
    for (int i = 0; i < 4; ++i) display(region_[i], std::optional(values[i]));
  }
  if (live) return;
  answer_->clear();
  switch (rig_.state()) {
    case RigLink::State::kOpening:
      picture_->setPlaceholder(tr("opening the camera ..."));
      break;
    case RigLink::State::kLent:
      picture_->setPlaceholder(tr("in use by a recording or calibration"));
      break;
    default:
      picture_->setPlaceholder(tr("no picture; choose a camera above, or reconnect"));
  }
}

void CameraPanel::refresh() {
  const StreamStatistics s = scene_ ? rig_.sceneStatistics() : rig_.sourceStatistics();
  link_->setText(tr("%1 frames/s, %2 frames; %3 lost, %4 incomplete, %5 dropped; %6 packets resent")
                     .arg(view().framesPerSecond(), 0, 'f', 0)
                     .arg(s.delivered)
                     .arg(s.lost - std::min(s.lost, s.underruns))
                     .arg(s.incomplete)
                     .arg(s.underruns)
                     .arg(s.packetsResent));
}

}  // namespace lightsketch
