#include <QComboBox>
#include <QLabel>
#include <QLineEdit>
#include <QProcess>
#include <QPushButton>
#include <QRegularExpression>
#include <QSpinBox>
#include <QTest>
#include <algorithm>

#include "pipeline/sketch/sketch.h"
#include "tests/ui/app/app_test.h"
#include "ui/app/frame_view.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/sketch_overlay.h"
#include "ui/app/sketch_pace.h"
#include "ui/app/sketch_prompt.h"

namespace lightsketch {
namespace {

constexpr int kStart = patience(60'000);   // the rig builds its still life first
constexpr int kAnswer = patience(20'000);  // cameras are opened, the ambient light is taken
constexpr int kRecord = patience(120'000);

RigSetup handHeldLamp() {
  RigSetup setup;
  setup.rig.sceneAddress = "127.0.42.11";
  setup.rig.sourceAddress = "127.0.42.12";
  return setup;
}

int framesOf(const std::filesystem::path& sketch) {
  const auto opened = Sketch::open(sketch);
  return opened ? static_cast<int>(opened->activeFrames().size()) : -1;
}

}  // namespace

class SketchPageTest : public QObject {
  Q_OBJECT

  // The Sketch page with live cameras, a few wanted directions and a folder of its own.
  static bool ready(AppTest& app, int goal) {
    app.window().showPage("sketch");
    app.find<QSpinBox>("directions")->setValue(64);
    app.find<QSpinBox>("coverageGoal")->setValue(goal);
    auto* folder = app.find<QComboBox>("folder");
    folder->setEditText(toQString(app.path("vase")));
    Q_EMIT folder->lineEdit()->editingFinished();
    RigLink& rig = app.workspace().rig();
    return QTest::qWaitFor([&] { return rig.sceneView().picture() && rig.sourceView().picture(); },
                           kStart) &&
           QTest::qWaitFor(
               [&] { return app.find<HemisphereView>("hemisphere")->dots().size() == 64; },
               kAnswer);
  }
  static void press(AppTest& app, const char* button) {
    QTest::mouseClick(app.find<QPushButton>(button), Qt::LeftButton);
  }
  static QString word(AppTest& app) { return app.find<SketchPrompt>("prompt")->content().word; }
  static int captured(AppTest& app) {
    const auto& dots = app.find<HemisphereView>("hemisphere")->dots();
    return static_cast<int>(std::count_if(dots.begin(), dots.end(), [](const auto& dot) {
      return dot.colour == colourOf(SketchDot::kCaptured);
    }));
  }
  static bool idle(AppTest& app) { return app.workspace().rig().state() != RigLink::State::kLent; }
  // A circle dragged on the hemisphere, from its middle outwards.
  static void dragRegion(AppTest& app, const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
    auto* view = app.find<HemisphereView>("hemisphere");
    QTest::mousePress(view, Qt::LeftButton, {}, view->project(from).toPoint());
    QTest::mouseMove(view, view->project(0.5 * (from + to)).toPoint());
    QTest::mouseMove(view, view->project(to).toPoint());
    QTest::mouseRelease(view, Qt::LeftButton, {}, view->project(to).toPoint());
  }

 private Q_SLOTS:
  void fitsIntoASmallWindow() {
    AppTest app(handHeldLamp());
    const QSize least = app.window().page("sketch")->minimumSizeHint();
    // Beside the pages' list and between menu and status bar.
    QVERIFY2(least.width() <= 1280 - 116 && least.height() <= 720 - 60,
             qPrintable(QString("%1 x %2").arg(least.width()).arg(least.height())));
  }

  void recordsIsPausedTakesBackAndShootsARegionAgain() {
    AppTest app(handHeldLamp());
    QVERIFY(ready(app, 90));
    QCOMPARE(word(app), "Ready");
    app.screenshot("sketch-ready");
    QTest::keyClick(app.window().currentPage(), Qt::Key_Space);
    QTRY_COMPARE_WITH_TIMEOUT(word(app), "Lamp off, please", kAnswer);
    app.screenshot("sketch-ambient");
    QTRY_VERIFY_WITH_TIMEOUT(captured(app) >= 12, kRecord);
    app.screenshot("sketch-recording");

    // Paused: nothing is kept.
    QTest::keyClick(app.window().currentPage(), Qt::Key_Space);
    QTRY_COMPARE_WITH_TIMEOUT(word(app), "Paused", kAnswer);
    QTest::qWait(300);  // what was on its way to the disk
    const int before = captured(app);
    QTest::qWait(1500);
    QCOMPARE(captured(app), before);
    app.screenshot("sketch-paused");

    // Two undone, one after another.
    QUndoStack& undo = app.workspace().undo();
    QVERIFY(undo.canUndo());
    undo.undo();
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), before - 1, kAnswer);
    QTest::keyClick(&app.window(), Qt::Key_Z, Qt::ControlModifier);
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), before - 2, kAnswer);
    QVERIFY2(!undo.canRedo(), "what was taken back is shot again");

    // A region goes, and comes back by undo.
    const auto dots = app.find<HemisphereView>("hemisphere")->dots();
    const auto kept = std::find_if(dots.begin(), dots.end(), [](const auto& dot) {
      return dot.colour == colourOf(SketchDot::kCaptured) && dot.direction.z() > 0.5;
    });
    QVERIFY(kept != dots.end());
    const Eigen::Vector3d centre = kept->direction;
    dragRegion(app, centre, (centre + 0.5 * centre.unitOrthogonal()).normalized());
    QTRY_VERIFY_WITH_TIMEOUT(captured(app) < before - 2, kAnswer);
    undo.undo();
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), before - 2, kAnswer);

    QTest::keyClick(app.window().currentPage(), Qt::Key_Space);
    QTRY_VERIFY_WITH_TIMEOUT(captured(app) > before, kRecord);
    press(app, "stop");
    QTRY_VERIFY_WITH_TIMEOUT(idle(app), kAnswer);
    QCOMPARE(word(app), "Stopped");
    QCOMPARE(app.workspace().sketch(), app.path("vase"));
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), framesOf(app.path("vase")), kAnswer);
    app.screenshot("sketch-stopped");

    // After the recording a deleted region is a job, and so is its undoing.
    // This one is chosen by keys: a circle in the middle, made so large that the dot above is in it.
    const int frames = framesOf(app.path("vase"));
    auto* hemisphere = app.find<HemisphereView>("hemisphere");
    QTest::keyClick(hemisphere, Qt::Key_Right);
    QTest::keyClick(hemisphere, Qt::Key_Left);
    for (int i = 0; i < 14; ++i) QTest::keyClick(hemisphere, Qt::Key_Plus);
    app.screenshot("sketch-region-by-keys");
    QCOMPARE(framesOf(app.path("vase")), frames);
    QTest::keyClick(hemisphere, Qt::Key_Delete);
    QTRY_VERIFY_WITH_TIMEOUT(framesOf(app.path("vase")) < frames, kAnswer);
    QTRY_VERIFY_WITH_TIMEOUT(captured(app) < frames, kAnswer);
    undo.undo();
    QTRY_COMPARE_WITH_TIMEOUT(framesOf(app.path("vase")), frames, kAnswer);
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), frames, kAnswer);

    // The finished sketch of yesterday: a window that opens it shows its dots and goes on.
    press(app, "newSketch");
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), 0, kAnswer);
    QVERIFY(app.workspace().open(app.path("vase")));
    app.window().showPage("sketch");
    QTRY_COMPARE_WITH_TIMEOUT(captured(app), frames, kAnswer);
    QVERIFY(!app.find<QSpinBox>("directions")->isEnabled());
    QCOMPARE(app.find<QPushButton>("record")->text(), "Go on &recording");
    app.screenshot("sketch-resumed");
    QTRY_VERIFY_WITH_TIMEOUT(app.workspace().rig().state() == RigLink::State::kLive, kStart);
    press(app, "record");
    QTRY_VERIFY_WITH_TIMEOUT(framesOf(app.path("vase")) > frames, kRecord);
    press(app, "stop");
    QTRY_VERIFY_WITH_TIMEOUT(idle(app), kAnswer);
  }

  void aKilledRigIsABannerAndTheRecordingGoesOn() {
    QTemporaryDir calibration;
    const QStringList arguments{
        "rig",         "--scene-address", "127.0.42.21",     "--source-address",
        "127.0.42.22", "--calibration",   calibration.path()};
    QProcess process;
    process.start(LIGHTSKETCH_BINARY, arguments);
    QVERIFY(process.waitForReadyRead(kStart));
    RigSetup setup;
    setup.simulated = false;
    setup.sceneCamera = "aravis:127.0.42.21";
    setup.sourceCamera = "aravis:127.0.42.22";
    setup.sourceModel = toPath(calibration.filePath("source.json"));
    setup.rigGeometry = toPath(calibration.filePath("rig.json"));
    AppTest app(setup);
    QVERIFY(ready(app, 100));
    press(app, "record");
    QTRY_VERIFY_WITH_TIMEOUT(captured(app) >= 5, kRecord);

    process.kill();
    QVERIFY(process.waitForFinished());
    QTRY_COMPARE_WITH_TIMEOUT(word(app), "Camera lost", kAnswer);
    QTRY_VERIFY(app.banner("warning/vase").contains("frames are kept"));
    QTest::qWait(300);  // what else might be said
    QCOMPARE(app.window().findChildren<QWidget*>(QRegularExpression("^banner/")).size(), 1);
    app.screenshot("sketch-camera-lost");
    const int kept = framesOf(app.path("vase"));
    QVERIFY(kept >= 5);
    QCOMPARE(captured(app), kept);

    process.start(LIGHTSKETCH_BINARY, arguments);
    QVERIFY(process.waitForReadyRead(kStart));
    QTRY_VERIFY_WITH_TIMEOUT(framesOf(app.path("vase")) > kept, kRecord);
    // What was said of the loss, that is: the recording's other warnings stand in the same place.
    QTRY_VERIFY_WITH_TIMEOUT(!app.banner("warning/vase").contains("frames are kept"), kAnswer);
    QVERIFY2(app.workspace().running() == 1, "it is still the same recording");
    press(app, "stop");
    QTRY_VERIFY_WITH_TIMEOUT(idle(app), kAnswer);
    QVERIFY(framesOf(app.path("vase")) > kept);
    process.kill();
    process.waitForFinished();
  }

  void nobodyIsShoutedAtForASingleFrame() {
    SketchPace pace;
    const TimePoint start = Clock::now();
    const auto judge = [&](double seconds, Refusal refusal) {
      JudgedFrame frame;
      frame.refusal = refusal;
      frame.decided = start + fromSeconds(seconds);
      pace.add(frame);
    };
    for (int i = 0; i < 12; ++i) judge(i / 12.0, i == 5 ? Refusal::kLampTooFast : Refusal::kNone);
    QVERIFY(!pace.trouble(start + fromSeconds(1)).has_value());
    for (int i = 12; i < 24; ++i) judge(i / 12.0, Refusal::kLampTooFast);
    QCOMPARE(pace.trouble(start + fromSeconds(2)), std::optional(Refusal::kLampTooFast));
    QVERIFY2(!pace.trouble(start + fromSeconds(4)).has_value(), "two seconds later it is history");
    // Eleven in the first second of two.
    QCOMPARE(pace.keptPerMinute(start + fromSeconds(2)), 60 * 11 / 2.0);
    // What is part of normal work is no trouble.
    for (int i = 48; i < 72; ++i) judge(i / 12.0, Refusal::kNotNew);
    QVERIFY(!pace.trouble(start + fromSeconds(6)).has_value());
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::SketchPageTest)
#include "sketch_page_test.moc"
