#include "ui/app/relight_page.h"

#include <QComboBox>
#include <QGuiApplication>
#include <QMenu>
#include <QPushButton>
#include <QSignalSpy>
#include <QTest>
#include <QToolButton>
#include <cmath>
#include <memory>

#include "capture/frame/file.h"
#include "pipeline/compress/compress.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/sketch/image_file.h"
#include "tests/ui/app/app_test.h"
#include "ui/app/relight_environment_panel.h"
#include "ui/app/relight_lamps_panel.h"
#include "ui/app/relight_path_panel.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 160;
constexpr int kHeight = 120;

// A matte ball before a matte wall; nothing casts shadows, so it is linear in the light where that
// reaches.
RadianceImage ballUnder(const Vector3d& light) {
  RadianceImage picture(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double u = (x + 0.5 - kWidth / 2.0) / (kHeight * 0.42);
      const double v = -(y + 0.5 - kHeight / 2.0) / (kHeight * 0.42);
      const bool ball = u * u + v * v < 1;
      const Vector3d normal =
          ball ? Vector3d(u, v, std::sqrt(1 - u * u - v * v)) : Vector3d::UnitZ();
      const double shade = std::max(0.0, normal.dot(light));
      const bool stripe = static_cast<int>(std::floor(4 * (u + v))) % 2 == 0;
      const Vector3d colour = ball     ? Vector3d(0.75, 0.55, 0.35)
                              : stripe ? Vector3d(0.25, 0.3, 0.35)
                                       : Vector3d(0.18, 0.2, 0.25);
      for (int c = 0; c < 3; ++c) picture(x, y, c) = static_cast<float>(shade * colour[c]);
    }
  }
  return picture;
}

}  // namespace

class RelightPageTest : public QObject {
  Q_OBJECT

 private:
  QTemporaryDir folder_;
  std::filesystem::path sketch_;
  std::filesystem::path model_;

  // One window for all: each would start a simulated rig.
  std::unique_ptr<AppTest> app_;

  // The page as it is with the model just opened.
  RelightPage& opened(AppTest& app) {
    auto* page = static_cast<RelightPage*>(app.window().page("relight"));
    page->setLight(RelightPage::Light::kLamps);
    page->lamps().setMoving(false);
    page->path().setMoving(false);
    page->lamps().setLamps({LampsPanel::Lamp{}});
    app.workspace().undo().clear();
    QSignalSpy shown(page, &RelightPage::sceneShown);
    app.workspace().open(model_);
    if (shown.isEmpty()) (void)shown.wait(10000);
    return *page;
  }
  // Mean level of a part of the picture, from the left (0) to the right (1).
  static double level(RelightPage& page, double from, double to) {
    QTest::qWait(250);  // drawn, and once more at rest
    const QImage picture = page.view().grab().toImage();
    double sum = 0;
    int count = 0;
    for (int y = picture.height() * 2 / 5; y < picture.height() * 3 / 5; ++y) {
      for (int x = static_cast<int>(from * picture.width());
           x < static_cast<int>(to * picture.width()); ++x, ++count) {
        sum += qGray(picture.pixel(x, y));
      }
    }
    return sum / count;
  }
  void idle(AppTest& app) { QTRY_COMPARE_WITH_TIMEOUT(app.workspace().running(), 0, 10000); }

 private Q_SLOTS:
  void initTestCase() {
    sketch_ = toPath(folder_.filePath("ball"));
    const auto grid = LightGrid::create(100);
    SketchManifest manifest;
    manifest.width = kWidth;
    manifest.height = kHeight;
    auto sketch = Sketch::create(sketch_, manifest);
    QVERIFY2(sketch.has_value(), sketch ? "" : sketch.error().message.c_str());
    double seconds = 0;
    for (const Vector3d& direction : grid->directions()) {
      FrameRecord record;
      record.light.direction = direction;
      record.midExposureSeconds = seconds += 0.1;
      QVERIFY(sketch->appendUnsynced(record, ballUnder(direction)).has_value());
    }
    QVERIFY(sketch->sync().has_value());
    SilentProgress progress;
    CompressOptions options;
    options.holdOutRule = "every:8:4";
    auto made = compress(*sketch, options, progress);
    QVERIFY2(made.has_value(), made ? "" : made.error().message.c_str());
    made->model.sketch = sketch_.string();
    model_ = toPath(folder_.filePath("ball.lsd"));
    QVERIFY(saveModel(made->model, model_).has_value());
    RigSetup setup;
    setup.rig.sceneAddress = "127.0.44.11";
    setup.rig.sourceAddress = "127.0.44.12";
    app_ = std::make_unique<AppTest>(setup);
  }
  void cleanupTestCase() { app_.reset(); }

  void aLampLightsTheSideItStandsOn() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    page.lamps().setLamps({{Vector3d(-0.9, 0, 0.44).normalized()}});
    page.findExposure();
    const double leftLit = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    page.lamps().setLamps({{Vector3d(0.9, 0, 0.44).normalized()}});
    const double rightLit = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    QVERIFY2(leftLit > 20 && rightLit < -20,
             qPrintable(QString("%1 %2").arg(leftLit).arg(rightLit)));
    app.screenshot("relight-lamps");
  }

  void draggingThePictureMovesTheLampAndUndoTakesItBack() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    const Vector3d before = page.lamps().lamps()[0].direction;
    const QPoint middle = page.view().rect().center();
    QTest::mousePress(&page.view(), Qt::LeftButton, {}, middle);
    QTest::mouseMove(&page.view(), middle + QPoint(40, 0));
    QTest::mouseMove(&page.view(), middle + QPoint(120, 0));
    QTest::mouseRelease(&page.view(), Qt::LeftButton, {}, middle + QPoint(120, 0));
    QVERIFY(page.lamps().lamps()[0].direction.x() > before.x() + 0.2);
    app.workspace().undo().undo();
    QVERIFY((page.lamps().lamps()[0].direction - before).norm() < 1e-9);
  }

  void lampsAreAddedAndRemovedByKeys() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    page.view().setFocus();
    QTest::keyClick(&page.view(), Qt::Key_Insert);
    QTest::keyClick(&page.view(), Qt::Key_Insert);
    QCOMPARE(page.lamps().lamps().size(), 3u);
    QTest::keyClick(&page.view(), Qt::Key_Delete);
    QCOMPARE(page.lamps().lamps().size(), 2u);
    QTest::keyClick(&app.window(), Qt::Key_Z, Qt::ControlModifier);
    QCOMPARE(page.lamps().lamps().size(), 3u);
  }

  void threeLampsGoRound() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    page.lamps().setLamps({{Vector3d(-0.7, 0.3, 0.6).normalized(), QColor(255, 200, 150), 1, 3},
                           {Vector3d(0.7, 0.3, 0.6).normalized(), QColor(150, 200, 255), 1, 12},
                           {Vector3d(0, -0.8, 0.5).normalized(), Qt::white, 0.5, 0}});
    page.findExposure();
    page.begin();
    QTest::qWait(1500);
    QVERIFY(page.view().statistics().framesPerSecond > 0);
    QVERIFY(app.workspace().statistics().summary("light's change to pixels, ms").count > 5);
    app.screenshot("relight-three-lamps");
    page.lamps().setMoving(false);
    idle(app);
  }

  void surroundingsAreTurnedByDraggingThePicture() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    // A sky that is bright in a quarter only: at -x, the right quarter of the map.
    RadianceImage map(64, 32, 3, 0.02f);
    for (int y = 8; y < 24; ++y) {
      for (int x = 44; x < 52; ++x) {
        for (int c = 0; c < 3; ++c) map(x, y, c) = 4;
      }
    }
    const auto file = app.path("sky.exr");
    QVERIFY(writeExr(file, map).has_value());
    page.setLight(RelightPage::Light::kSurroundings);
    page.surroundings().open(file);
    idle(app);
    page.findExposure();
    const double fromLeft = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    QVERIFY2(fromLeft > 10, qPrintable(QString::number(fromLeft)));
    app.screenshot("relight-surroundings");
    const QPoint middle = page.view().rect().center();
    QTest::mousePress(&page.view(), Qt::LeftButton, {}, middle);
    for (int x = 0; x <= 2 * middle.y(); x += 20) {  // half a turn
      QTest::mouseMove(&page.view(), middle + QPoint(x, 0));
    }
    QTest::mouseRelease(&page.view(), Qt::LeftButton, {}, middle);
    const double fromRight = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    QVERIFY2(fromRight < -10, qPrintable(QString::number(fromRight)));
  }

  void theSketchsOwnPathIsPlayed() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    page.setLight(RelightPage::Light::kPath);
    QCOMPARE(page.path().path().points().size(), 100u);
    page.begin();
    QTRY_VERIFY_WITH_TIMEOUT(page.path().seconds() > 0.3, 5000);
    app.screenshot("relight-path");
  }

  void aLightsFileIsAPath() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    const auto file = app.path("lights.json");
    QVERIFY(writeFileAtomically(file,
                                R"({"format": "lightsketch-lights", "formatVersion": 1, "lights": [
        {"direction": [-0.9, 0, 0.44]},
        {"direction": [0.9, 0, 0.44]}]})")
                .has_value());
    page.setLight(RelightPage::Light::kPath);
    page.path().open(file);
    QCOMPARE(page.path().path().points().size(), 2u);
    page.findExposure();
    const double atBegin = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    auto* time = page.path().findChild<QSlider*>("pathTime");
    time->setValue(time->maximum());
    const double atEnd = level(page, 0.3, 0.45) - level(page, 0.55, 0.7);
    QVERIFY2(atBegin > 20 && atEnd < -20, qPrintable(QString("%1 %2").arg(atBegin).arg(atEnd)));
  }

  void theRoomBeforeTheSourceCameraLightsThePicture() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    page.setLight(RelightPage::Light::kRoom);
    auto* state = app.find<QLabel>("roomState");
    QTRY_VERIFY2_WITH_TIMEOUT(state->text().contains("of the half sphere in sight"),
                              qPrintable(state->text()), patience(60'000));
    // The simulated rig's lamp goes round: every frame of the camera is another light.
    QSignalSpy shown(&page.view(), &RelightView::shown);
    QTRY_VERIFY_WITH_TIMEOUT(shown.count() > 10, patience(20'000));
    QVERIFY(level(page, 0.3, 0.7) > 20);
    app.screenshot("relight-room");
    page.setLight(RelightPage::Light::kLamps);
  }

  void aPhotographStandsBesideThePictureOfItsLamp() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    auto* list = app.find<QComboBox>("photographs");
    QVERIFY2(list->count() > 10, "every eighth of 100 was held out");
    page.compareWith(list->itemData(5).toInt());
    idle(app);
    const double relit = level(page, 0.05, 0.45);
    const double photographed = level(page, 0.55, 0.95);
    QVERIFY2(std::abs(relit - photographed) < 3,
             qPrintable(QString("%1 %2").arg(relit).arg(photographed)));
    app.screenshot("relight-compare");
  }

  void pictureAndFilmAreSaved() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    page.savePicture(app.path("picture.exr"));
    page.savePicture(app.path("picture.png"));
    page.lamps().setLamps({LampsPanel::Lamp{}});
    page.saveFilm(app.path("film"), 1);
    idle(app);
    const auto picture = readImage(app.path("picture.exr"));
    QVERIFY(picture.has_value());
    QCOMPARE(picture->width(), kWidth);
    QVERIFY(std::filesystem::exists(app.path("picture.png")));
    QVERIFY(std::filesystem::exists(app.path("film") / "frame-0016.png"));
    QVERIFY(!std::filesystem::exists(app.path("film") / "frame-0017.png"));
  }

  void aCancelledFilmLeavesNothing() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    idle(app);
    QSignalSpy started(&app.workspace(), &Workspace::taskStarted);
    page.saveFilm(app.path("cancelled"), 500);
    started.front().front().value<Task*>()->cancel();
    idle(app);
    QVERIFY(!std::filesystem::exists(app.path("cancelled")));
    QVERIFY(!std::filesystem::exists(app.path("cancelled.partial")));
  }

  void theFullScreenShowsThePictureAloneAndEscapeLeavesIt() {
    AppTest& app = *app_;
    RelightPage& page = opened(app);
    page.fillScreen(page.screen());
    RelightView* view = page.fullScreenView();
    QVERIFY(QTest::qWaitForWindowExposed(view));
    QTest::qWait(200);
    QCOMPARE(view->size(), page.screen()->size());
    const QImage picture = view->grab().toImage();
    QVERIFY(qGray(picture.pixel(picture.rect().center())) > 30);
    QTest::keyClick(view, Qt::Key_Escape);
    QTRY_VERIFY(!page.fullScreenView());

    // On a display chosen from the menu.
    QMenu* displays = app.find<QToolButton>("fullScreen")->menu();
    Q_EMIT displays->aboutToShow();
    QCOMPARE(displays->actions().size(), QGuiApplication::screens().size());
    displays->actions().back()->trigger();
    view = page.fullScreenView();
    QVERIFY(QTest::qWaitForWindowExposed(view));
    QTRY_COMPARE(view->screen(), QGuiApplication::screens().back());
    QVERIFY2(view->isWindow() && view->isFullScreen() && view->findChildren<QPushButton*>().empty(),
             "the picture and nothing around it");
    QTest::keyClick(view, Qt::Key_F11);
    QTRY_VERIFY(!page.fullScreenView());
  }

  void softHighlightsKeepWhatIsBelowHalfOfWhite() {
    QCOMPARE(toneMapped(0.4f, Tone::kSoft), 0.4f);
    QVERIFY(toneMapped(2, Tone::kSoft) < 1);
    QVERIFY(toneMapped(2, Tone::kSoft) > toneMapped(1, Tone::kSoft));
    // The table's picture is the formula's, to a level and what half floats round.
    auto scene = RelightScene::load(model_);
    QVERIFY(scene.has_value());
    const DiscLamp lamp{Vector3d(0, 0, 1), Vector3d::Constant(3), Angle()};
    QVERIFY((*scene)->relighter.setLight((*scene)->intensitiesOf({&lamp, 1})).has_value());
    RadianceImage linear(kWidth, kHeight, 3);
    (*scene)->relighter.render(linear);
    const QImage expected = screenImage(linear, 1, Tone::kSoft);
    QImage drawn(kWidth, kHeight, QImage::Format_RGB32);
    ScreenRenderer renderer;
    renderer.render(
        (*scene)->relighter, Tone::kSoft, {},
        {reinterpret_cast<std::byte*>(drawn.bits()), static_cast<std::size_t>(drawn.sizeInBytes())},
        static_cast<std::size_t>(drawn.bytesPerLine()));
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        QVERIFY(std::abs(qRed(drawn.pixel(x, y)) - qRed(expected.pixel(x, y))) <= 1);
      }
    }
  }

  void aPathGoesAlongTheGreatCircle() {
    const DirectionalLamp lamps[] = {{Vector3d::UnitX(), {1, 0, 0}},
                                     {Vector3d::UnitZ(), {0, 0, 1}}};
    const auto path = LightPath::ofLamps(lamps);
    QCOMPARE(path.seconds(), LightPath::kStep);
    const DirectionalLamp middle = path.at(LightPath::kStep / 2);
    QVERIFY((middle.direction - Vector3d(1, 0, 1).normalized()).norm() < 1e-12);
    QVERIFY((middle.colour - Vector3d(0.5, 0, 0.5)).norm() < 1e-12);
    QCOMPARE(path.at(-1).direction, Vector3d::UnitX());
    QCOMPARE(path.at(99).direction, Vector3d::UnitZ());
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::RelightPageTest)
#include "relight_page_test.moc"
