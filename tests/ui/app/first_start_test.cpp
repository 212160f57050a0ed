// Somebody who has never used it, from the first start to a relit and validated picture.
#include <QLabel>
#include <QLineEdit>
#include <QListWidget>
#include <QPushButton>
#include <QSpinBox>
#include <QTableView>
#include <QTest>

#include "capture/frame/file.h"
#include "capture/frame/json.h"
#include "tests/ui/app/app_test.h"
#include "ui/app/frame_view.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/relight_page.h"
#include "ui/app/sketch_options.h"
#include "ui/app/sketch_prompt.h"
#include "ui/app/validate_page.h"

namespace lightsketch {
namespace {

constexpr int kStart = patience(60'000);  // the rig builds its still life first
constexpr int kLong = patience(120'000);  // work that takes seconds on an idle machine
constexpr int kRecord = patience(200'000);

RigSetup atHome() {
  RigSetup setup;
  setup.rig.sceneAddress = "127.0.42.41";
  setup.rig.sourceAddress = "127.0.42.42";
  return setup;
}

}  // namespace

class FirstStartTest : public QObject {
  Q_OBJECT

  static void press(AppTest& app, const char* button) {
    auto* widget = app.find<QPushButton>(button);
    QVERIFY2(widget, button);
    QTRY_VERIFY2_WITH_TIMEOUT(widget->isEnabled() && widget->isVisible(), button, kLong);
    QTest::mouseClick(widget, Qt::LeftButton);
  }
  // The next page, as it is chosen in the list at the left.
  static void choose(AppTest& app, const char* page) {
    app.window().showPage(page);
    QCOMPARE(app.window().currentPage(), app.window().page(page));
  }
  // Of the picture; a black one has none.
  static double contrast(const QImage& picture) {
    int least = 255;
    int most = 0;
    for (int y = 0; y < picture.height(); y += 4) {
      for (int x = 0; x < picture.width(); x += 4) {
        least = std::min(least, qGray(picture.pixel(x, y)));
        most = std::max(most, qGray(picture.pixel(x, y)));
      }
    }
    return most - least;
  }

 private Q_SLOTS:
  void fromTheFirstStartToARelitValidatedPicture() {
    AppTest app(atHome());
    // Without cameras the simulated rig is there and shows its pictures.
    QCOMPARE(app.window().currentPage(), app.window().page("rig"));
    RigLink& rig = app.workspace().rig();
    QTRY_VERIFY_WITH_TIMEOUT(rig.sceneView().picture() && rig.sourceView().picture(), kStart);
    app.screenshot("start-1-rig");

    choose(app, "calibrate");
    app.screenshot("start-2-calibrate");

    // A small sketch, all by itself but for one key.
    choose(app, "sketch");
    app.find<QSpinBox>("directions")->setValue(64);
    app.find<QSpinBox>("coverageGoal")->setValue(60);
    app.find<SketchOptions>("options")->setFolder(app.path("still life"));
    QTRY_VERIFY_WITH_TIMEOUT(app.find<FrameView>("sourceView")->pictureRectangle().isValid(),
                             kStart);
    QTest::keyClick(app.window().currentPage(), Qt::Key_Space);
    QTRY_VERIFY_WITH_TIMEOUT(app.find<SketchPrompt>("prompt")->content().coverage > 0.3, kRecord);
    app.screenshot("start-3-sketch");
    QTRY_COMPARE_WITH_TIMEOUT(app.find<SketchPrompt>("prompt")->content().word, "Done", kRecord);
    QTest::qWait(1500);  // pictures again
    app.screenshot("start-4-sketch-done");

    // The way on is a button each time.
    press(app, "developSketch");
    QCOMPARE(app.window().currentPage(), app.window().page("develop"));
    press(app, "develop");
    QTRY_VERIFY_WITH_TIMEOUT(!app.workspace().model().empty(), kLong);
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().running(), 0, kLong);
    app.screenshot("start-5-develop");

    choose(app, "relight");
    auto* relight = static_cast<RelightPage*>(app.window().page("relight"));
    QTRY_VERIFY_WITH_TIMEOUT(relight->scene() != nullptr, kLong);
    QTRY_VERIFY_WITH_TIMEOUT(contrast(relight->view().grab().toImage()) > 60, kLong);
    app.screenshot("start-6-relight");

    choose(app, "validate");
    press(app, "validate");
    QTRY_VERIFY_WITH_TIMEOUT(app.find<QTableView>("lights")->model()->rowCount() > 0, kLong);
    QTest::qWait(1000);
    app.screenshot("start-7-validate");
    const auto report = readJsonFile(app.workspace().report() / "report.json");
    QVERIFY(report.has_value());
    const double psnr = report->at("mean").at("psnrDb").get<double>();
    // 40 directions of a scene with sharp shadows: rough, but a picture (a black one has 10 dB).
    QVERIFY2(psnr > 16, qPrintable(QString::number(psnr)));
    QVERIFY(app.find<QLabel>("figures")->text().contains(QString::number(psnr, 'f', 2)));
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::FirstStartTest)
#include "first_start_test.moc"
