#include <QCheckBox>
#include <QComboBox>
#include <QDoubleSpinBox>
#include <QProcess>
#include <QPushButton>
#include <QSpinBox>
#include <QTest>

#include "tests/ui/app/app_test.h"
#include "ui/app/camera_panel.h"
#include "ui/app/rig_setup_settings.h"

namespace lightsketch {
namespace {

constexpr int kStart = patience(30'000);  // the rig builds its still life first
constexpr int kAnswer = patience(10'000);

constexpr double kRate = 8;

// Nothing moves and the light is steady, so that a setting alone changes the picture.
SimulatedRigOptions still() {
  SimulatedRigOptions rig;
  rig.sceneAddress = "127.0.41.11";
  rig.sourceAddress = "127.0.41.12";
  rig.program = RigProgram::kStill;
  rig.framesPerSecond = kRate;
  return rig;
}

RigSetup camerasAt(const std::string& scene, const std::string& source) {
  RigSetup setup;
  setup.simulated = false;
  setup.sceneCamera = "aravis:" + scene;
  setup.sourceCamera = "aravis:" + source;
  setup.scene.framesPerSecond = setup.source.framesPerSecond = kRate;
  return setup;
}

double meanCount(const ViewPicture& picture) {
  double sum = 0;
  double pixels = 0;
  for (std::size_t i = 0; i < 64; ++i) {
    sum += static_cast<double>(i) * picture.histogram[1][i];
    pixels += picture.histogram[1][i];
  }
  return sum / pixels;
}

}  // namespace

class RigPageTest : public QObject {
  Q_OBJECT

  std::unique_ptr<SimulatedRig> rig_;  // for the tests that need cameras and nothing else

  static bool live(AppTest& app) {
    RigLink& rig = app.workspace().rig();
    return QTest::qWaitFor(
        [&] {
          return rig.state() == RigLink::State::kLive && rig.sceneView().picture() &&
                 rig.sourceView().picture();
        },
        kStart);
  }
  template <class Widget>
  static Widget* in(AppTest& app, const char* panel, const char* name) {
    return app.find<CameraPanel>(panel)->findChild<Widget*>(name);
  }
  // Asks for an exposure as somebody who types it, and waits for a frame of it.
  static bool expose(AppTest& app, double milliseconds) {
    in<QDoubleSpinBox>(app, "scenePanel", "exposure")->setValue(milliseconds);
    return QTest::qWaitFor(
        [&] {
          const auto picture = app.workspace().rig().sceneView().picture();
          return picture && qAbs(1e3 * picture->metadata.exposureSeconds / milliseconds - 1) < 1e-3;
        },
        kAnswer);
  }

 private Q_SLOTS:
  void initTestCase() {
    auto rig = SimulatedRig::start(still());
    QVERIFY2(rig.has_value(), rig ? "" : rig.error().message.c_str());
    rig_ = std::move(*rig);
  }

  void withoutCamerasTheSimulatedRigIsSeen() {
    RigSetup setup;
    setup.rig = still();
    setup.rig.sceneAddress = "127.0.41.13";
    setup.rig.sourceAddress = "127.0.41.14";
    setup.scene.framesPerSecond = setup.source.framesPerSecond = kRate;
    AppTest app(setup);
    QCOMPARE(app.find<QComboBox>("mode")->currentIndex(), 0);
    QVERIFY(live(app));
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QLabel>("state")->text(), "live", kAnswer);
    // The link's figures and the pairing follow.
    QTRY_VERIFY_WITH_TIMEOUT(app.workspace().rig().sceneStatistics().delivered > 8, kAnswer);
    QTRY_VERIFY_WITH_TIMEOUT(
        in<QLabel>(app, "scenePanel", "link")->text().contains("0 lost, 0 incomplete, 0 dropped"),
        kAnswer);
    QTRY_VERIFY_WITH_TIMEOUT(app.find<QLabel>("pairing")->text().contains(" ms apart"), kAnswer);
    // Both run free: nearest frames are at most half a period apart.
    const double apart = app.find<QLabel>("pairing")->text().split(' ').at(6).toDouble();
    QVERIFY2(apart >= 0 && apart < LIGHTSKETCH_PATIENCE * (1000 / kRate / 2 + 10),
             qPrintable(QString::number(apart)));
    QVERIFY(in<QLabel>(app, "scenePanel", "answer")->text().contains("exposure 20 ms"));
    // 1280 pixels, less the list of pages.
    QVERIFY2(app.window().currentPage()->minimumSizeHint().width() <= 1164,
             qPrintable(QString::number(app.window().currentPage()->minimumSizeHint().width())));
    app.screenshot("rig");
  }

  void aLongerExposureIsAnsweredAndMakesThePictureBrighter() {
    AppTest app(camerasAt("127.0.41.11", "127.0.41.12"));
    QVERIFY(live(app));
    RigLink& rig = app.workspace().rig();
    QVERIFY(expose(app, 10));
    const double dark = meanCount(*rig.sceneView().picture());
    QVERIFY(expose(app, 30));
    QTRY_VERIFY(in<QLabel>(app, "scenePanel", "answer")->text().contains("exposure 30 ms"));
    const double bright = meanCount(*rig.sceneView().picture());
    // The sensor is linear and nothing is near saturation: three times the light above black, which
    // is one of 64 bins; bins round by half of one.
    QVERIFY2(bright - 1 > 2 * (dark - 1), qPrintable(QString("%1 %2").arg(dark).arg(bright)));

    // So long, and amplified so much, that it saturates: counted, and painted red.
    in<QCheckBox>(app, "scenePanel", "saturationOverlay")->setChecked(true);
    in<QDoubleSpinBox>(app, "scenePanel", "gain")->setValue(12);
    QVERIFY(expose(app, 1000));
    QTRY_VERIFY_WITH_TIMEOUT(rig.sceneView().picture()->saturatedFraction > 0.2, kAnswer);
    const auto picture = rig.sceneView().picture();
    int red = 0;
    for (int y = 0; y < picture->image.height(); ++y) {
      for (int x = 0; x < picture->image.width(); ++x) {
        red += picture->image.pixelColor(x, y) == QColor(0xff, 0x2a, 0x2a);
      }
    }
    const double share =
        static_cast<double>(red) / (picture->image.width() * picture->image.height());
    // The picture is scaled to the screen, which smooths the red parts' borders.
    QVERIFY2(qAbs(share - picture->saturatedFraction) < 0.1,
             qPrintable(QString("%1 %2").arg(share).arg(picture->saturatedFraction)));
    in<QCheckBox>(app, "sourcePanel", "focusOverlay")->setChecked(true);
    in<QCheckBox>(app, "scenePanel", "logarithmic")->setChecked(true);
    app.screenshot("rig-overlays");
  }

  void whatTheCameraCannotDoIsSaidInWordsAndNotRemembered() {
    AppTest app(camerasAt("127.0.41.11", "127.0.41.12"));
    QVERIFY(live(app));
    in<QDoubleSpinBox>(app, "scenePanel", "exposure")->setValue(100'000);
    auto* answer = in<QLabel>(app, "scenePanel", "answer");
    QTRY_VERIFY_WITH_TIMEOUT(answer->text().contains("outside the camera's"), kAnswer);
    QCOMPARE(*app.workspace().rig().setup().scene.exposureSeconds, 0.02);
    QCOMPARE(in<QDoubleSpinBox>(app, "scenePanel", "exposure")->value(), 20.0);
    app.screenshot("rig-refused");
  }

  void aDraggedRegionIsReadUntilTheFullFrameIsAsked() {
    AppTest app(camerasAt("127.0.41.11", "127.0.41.12"));
    QVERIFY(live(app));
    RigLink& rig = app.workspace().rig();
    auto* view = in<RegionView>(app, "sourcePanel", "picture");
    QTRY_VERIFY(view->pictureRectangle().isValid());
    const QTransform toWidget = view->widgetFromFrame();
    QTest::mousePress(view, Qt::LeftButton, {}, toWidget.map(QPointF(200, 100)).toPoint());
    QTest::mouseMove(view, toWidget.map(QPointF(500, 300)).toPoint());
    QTest::mouseRelease(view, Qt::LeftButton, {}, toWidget.map(QPointF(680, 420)).toPoint());
    const auto size = [&] {
      const auto picture = rig.sourceView().picture();
      return picture ? picture->frameSize : QSize();
    };
    // A pixel of the screen is several of the camera.
    QTRY_VERIFY_WITH_TIMEOUT(qAbs(size().width() - 480) < 12 && qAbs(size().height() - 320) < 12,
                             kAnswer);
    QVERIFY(qAbs(in<QSpinBox>(app, "sourcePanel", "regionX")->value() - 200) < 12);
    QTest::mouseClick(in<QPushButton>(app, "sourcePanel", "fullFrame"), Qt::LeftButton);
    QTRY_COMPARE_WITH_TIMEOUT(size(), QSize(960, 960), kAnswer);

    QTest::keyClick(in<QSpinBox>(app, "sourcePanel", "regionX"), Qt::Key_Up);
    in<QSpinBox>(app, "sourcePanel", "regionWidth")->setValue(5000);
    QTRY_VERIFY_WITH_TIMEOUT(
        in<QLabel>(app, "sourcePanel", "answer")->text().contains("leaves the sensor of 960x960"),
        kAnswer);
    QTRY_VERIFY_WITH_TIMEOUT(!size().isEmpty(), kAnswer);  // it goes on all the same
  }

  void aLostRigIsABannerAndReconnectBringsThePicturesBack() {
    const QStringList arguments{
        "rig", "--scene-address", "127.0.41.21", "--source-address", "127.0.41.22", "--rate", "8"};
    QProcess process;
    process.start(LIGHTSKETCH_BINARY, arguments);
    QVERIFY(process.waitForReadyRead(kStart));
    AppTest app(camerasAt("127.0.41.21", "127.0.41.22"));
    QVERIFY(live(app));
    QVERIFY(app.banner("camera").isEmpty());
    QCOMPARE(app.find<QPushButton>("calibrate")->text(), "Calibrate the lens first");

    process.kill();
    QVERIFY(process.waitForFinished());
    QTRY_VERIFY_WITH_TIMEOUT(!app.banner("camera").isEmpty(), kAnswer);
    app.screenshot("rig-lost");
    process.start(LIGHTSKETCH_BINARY, arguments);
    QVERIFY(process.waitForReadyRead(kStart));
    auto* button = app.window().findChild<QWidget*>("banner/camera")->findChild<QPushButton*>();
    QCOMPARE(button->text(), "Reconnect");
    QTest::mouseClick(button, Qt::LeftButton);
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().rig().state(), RigLink::State::kLive, kStart);
    QVERIFY(live(app));
    QVERIFY(app.banner("camera").isEmpty());
    process.kill();
    process.waitForFinished();
  }

  void theSetupIsThereAtTheNextStart() {
    QTemporaryDir folder;
    const QString file = folder.filePath("settings.ini");
    {
      Workspace workspace(file);
      QVERIFY2(workspace.rig().setup().simulated, "the first start needs no camera");
      RigSetup setup;
      setup.simulated = false;
      setup.sceneCamera = "aravis:10.0.0.1";
      setup.sourceCamera = "replay:/data/with space";
      setup.sourceModel = "/calibration/source.json";
      setup.scene.exposureSeconds = 0.0123;
      setup.scene.region = Region{8, 16, 320, 200};
      setup.source.format = PixelFormat::kMono12;
      setup.source.gainDb = 3.5;
      workspace.rig().setSetup(setup);
      workspace.rig().setCalibration(
          {"/calibration/source.json", "/calibration/rig.json", {}, "/calibration/scene.json"});
    }
    Workspace workspace(file);
    const RigSetup& setup = workspace.rig().setup();
    QVERIFY(!setup.simulated);
    QCOMPARE(setup.sceneCamera, "aravis:10.0.0.1");
    QCOMPARE(setup.sourceCamera, "replay:/data/with space");
    QCOMPARE(setup.sourceModel.string(), "/calibration/source.json");
    QCOMPARE(setup.rigGeometry.string(), "/calibration/rig.json");
    QVERIFY(setup.sceneResponse.empty());
    QCOMPARE(setup.sceneModel.string(), "/calibration/scene.json");
    QCOMPARE(*setup.scene.exposureSeconds, 0.0123);
    QVERIFY(setup.scene.region == (Region{8, 16, 320, 200}));
    QVERIFY(setup.source.format == PixelFormat::kMono12);
    QCOMPARE(*setup.source.gainDb, 3.5);
    QVERIFY(!setup.source.region);
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::RigPageTest)
#include "rig_page_test.moc"
