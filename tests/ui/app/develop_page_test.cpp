#include <QAbstractButton>
#include <QCheckBox>
#include <QDoubleSpinBox>
#include <QLabel>
#include <QLineEdit>
#include <QListWidget>
#include <QPushButton>
#include <QTabWidget>
#include <QTest>
#include <QToolButton>
#include <algorithm>

#include "pipeline/compress/model.h"
#include "tests/ui/app/app_test.h"
#include "tests/ui/app/ball_sketch.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/picture_view.h"

namespace lightsketch {

constexpr int kLong = patience(60000);  // for what takes a second on an idle machine

class DevelopPageTest : public QObject {
  Q_OBJECT

  static std::vector<int> droppedIn(const std::filesystem::path& folder) {
    const auto sketch = Sketch::open(folder);
    std::vector<int> ids;
    if (!sketch) return {-1};
    for (const FrameRecord& frame : sketch->frames())
      if (frame.dropped) ids.push_back(frame.id);
    return ids;
  }
  static bool open(AppTest& app, const BallSketch& ball) {
    ball.write(app.path("ball"));
    app.workspace().open(app.path("ball"));
    return QTest::qWaitFor([&] { return app.find<QPushButton>("develop")->isEnabled(); }, kLong);
  }
  static bool develop(AppTest& app) {
    app.find<QPushButton>("develop")->click();
    return QTest::qWaitFor(
        [&] {
          return app.workspace().running() == 0 &&
                 app.find<QPushButton>("develop")->text() == "Develop";
        },
        kLong);
  }

 private Q_SLOTS:
  void saysWhatToDoWithoutASketch() {
    AppTest app;
    app.window().showPage("develop");
    QVERIFY(!app.find<QPushButton>("develop")->isEnabled());
    QVERIFY(app.find<QLabel>("sketchCounts")->text().contains("Record one on the Sketch page"));
    app.screenshot("develop_empty");
  }

  void showsTheSketchAtHand() {
    AppTest app;
    QVERIFY(open(app, {}));
    QCOMPARE(app.find<QLabel>("sketchName")->text(), "ball");
    QVERIFY(app.find<QLabel>("sketchCounts")->text().startsWith("120 frames"));
    QCOMPARE(app.find<HemisphereView>("directions")->dots().size(), 120u);
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QListWidget>("thumbnails")->count(), 24, kLong);
    QTRY_VERIFY_WITH_TIMEOUT(!app.find<PictureView>("picture")->picture().isNull(), kLong);
    app.screenshot("develop");
  }

  void everyChoiceMakesItsModel_data() {
    QTest::addColumn<QString>("button");
    QTest::addColumn<QString>("setting");
    QTest::newRow("small") << "qualitySmall"
                           << "quality small";
    QTest::newRow("standard") << "qualityStandard"
                              << "quality standard";
    QTest::newRow("archive") << "qualityArchive"
                             << "quality archive";
    QTest::newRow("size") << "bySize"
                          << "the best in 100000 bytes";
    QTest::newRow("error") << "byPsnr"
                           << "the smallest of 38.00 dB (8-bit sRGB)";
    QTest::newRow("paper") << "paper"
                           << "the paper's, given ranks";
  }
  void everyChoiceMakesItsModel() {
    QFETCH(QString, button);
    QFETCH(QString, setting);
    AppTest app;
    QVERIFY(open(app, {}));
    app.find<QDoubleSpinBox>("bySizeValue")->setValue(0.1);
    app.find<QDoubleSpinBox>("byPsnrValue")->setValue(38);
    app.find<QAbstractButton>(button.toUtf8())->click();
    const auto file = toPath(app.find<QLineEdit>("modelFile")->text());
    QVERIFY(develop(app));
    const auto model = loadModel(file);
    QVERIFY2(model.has_value(), qPrintable(app.banner("task/Develop ball")));
    QCOMPARE(QString::fromStdString(model->notes.at("setting").get<std::string>()), setting);
    QCOMPARE(model->storage, button == "paper" ? Storage::kFloat16 : Storage::kPacked);
    // Frames are kept back, so that it can be measured at once.
    QCOMPARE(model->holdOutRule, "every:8:4");
    QCOMPARE(model->heldOutIds.size(), 15u);
    QCOMPARE(app.workspace().model(), file);
  }

  void theResultIsTheFilesAndThePictureTheModels() {
    AppTest app;
    QVERIFY(open(app, {}));
    QVERIFY(develop(app));
    const auto file = app.workspace().model();
    const double bytes = static_cast<double>(std::filesystem::file_size(file));
    const QString text = app.find<QLabel>("developResult")->text();
    QVERIFY2(text.contains(QString("%1 kB").arg(bytes / 1e3, 0, 'f', bytes < 1e4 ? 1 : 0)),
             qPrintable(text));
    const double psnr = loadModel(file)->notes.at("error").at("srgbPsnr").get<double>();
    QVERIFY2(text.contains(QString("%1 dB").arg(psnr, 0, 'f', 1)), qPrintable(text));
    auto* captured = app.find<QPushButton>("showCaptured");
    QTRY_VERIFY_WITH_TIMEOUT(captured->isVisible(), kLong);
    app.screenshot("develop_result");
    // A model of 30 dB and more: pictures differ by few grey levels, and are not the same.
    const QImage relit = app.find<PictureView>("picture")->picture();
    captured->click();
    const QImage truth = app.find<PictureView>("picture")->picture();
    QCOMPARE(relit.size(), QSize(64, 48));
    double sum = 0;
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 64; ++x)
        sum += std::abs(qGreen(relit.pixel(x, y)) - qGreen(truth.pixel(x, y)));
    }
    QVERIFY(sum > 0);
    QVERIFY(sum / (64 * 48) < 8);
    app.find<QPushButton>("toRelight")->click();
    QCOMPARE(app.window().currentPage(), app.window().page("relight"));
  }

  void withoutFramesKeptBackTheModelSeesAll() {
    AppTest app;
    QVERIFY(open(app, {}));
    app.find<QCheckBox>("holdOut")->setChecked(false);
    QVERIFY(develop(app));
    QCOMPARE(loadModel(app.workspace().model())->capturedIds.size(), 120u);
    QVERIFY(!app.find<QPushButton>("toValidate")->isEnabled());
  }

  void thePictureGetsSharpWhileItIsMade() {
    AppTest app;
    BallSketch large;
    large.width = 320;
    large.height = 240;
    large.frames = 60;
    QVERIFY(open(app, large));
    QTRY_VERIFY_WITH_TIMEOUT(!app.find<PictureView>("picture")->picture().isNull(), kLong);
    const QImage captured = app.find<PictureView>("picture")->picture();
    app.find<QPushButton>("develop")->click();
    // At first all pixels of a block are its mean, but for what smoothing makes of it.
    auto* view = app.find<PictureView>("picture");
    QVERIFY(view->picture() != captured);
    QVERIFY(view->caption().contains("means of a frame's blocks"));
    QTRY_VERIFY_WITH_TIMEOUT(view->caption().contains("of the blocks have their basis"), kLong);
    app.screenshot("develop_running");
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().running(), 0, 2 * kLong);
  }

  void cancelLeavesNoFile() {
    AppTest app;
    QVERIFY(open(app, {}));
    const auto folder = app.path("");
    const auto count = [&] {
      return std::distance(std::filesystem::directory_iterator(folder),
                           std::filesystem::directory_iterator());
    };
    const auto before = count();
    auto* button = app.find<QPushButton>("develop");
    button->click();
    QCOMPARE(button->text(), "Cancel");
    button->click();
    QTRY_COMPARE_WITH_TIMEOUT(button->text(), "Develop", kLong);
    QCOMPARE(count(), before);
    QVERIFY(app.workspace().model().empty());
    QVERIFY(app.find<QLabel>("developResult")->text().startsWith("Cancelled"));
  }

  void aFailureIsSaid() {
    AppTest app;
    QVERIFY(open(app, {}));
    auto* file = app.find<QLineEdit>("modelFile");
    file->setText("/nowhere/at/all/ball.lsd");
    QVERIFY(develop(app));
    QVERIFY(app.banner("task/Develop ball").contains("/nowhere/at/all"));
  }

  void badFramesAreFoundDroppedAndTakenBack() {
    AppTest app;
    BallSketch ball;
    ball.shadowed = {40, 77};
    ball.brightened = {60};
    QVERIFY(open(app, ball));
    app.find<QTabWidget>("developTabs")->setCurrentIndex(1);
    app.screenshot("frames_before");
    app.find<QPushButton>("checkFrames")->click();
    auto* list = app.find<QListWidget>("suspects");
    QTRY_VERIFY_WITH_TIMEOUT(list->count() >= 3, kLong);
    QStringList texts;
    for (int i = 0; i < list->count(); ++i) texts << list->item(i)->text();
    for (const auto& [frame, fault] :
         {std::pair{"Frame 40", "shadow"}, {"Frame 77", "shadow"}, {"Frame 60", "brightness"}}) {
      const auto rows = texts.filter(frame);
      QVERIFY2(rows.size() == 1 && rows.front().contains(fault), qPrintable(texts.join("; ")));
    }
    const auto row = [&](const QString& frame) {
      for (int i = 0; i < list->count(); ++i)
        if (list->item(i)->text().startsWith(frame)) return i;
      return -1;
    };
    list->setCurrentRow(row("Frame 77"));
    QVERIFY(app.find<QLabel>("suspectReason")->text().contains("your shadow"));
    auto* pictures = app.find<TripleView>("suspectPictures");
    for (int i = 0; i < 3; ++i) QVERIFY(!pictures->view(i)->picture().isNull());
    // The prediction has no bar: it is brighter there.
    const QImage is = pictures->view(0)->picture();
    const QImage should = pictures->view(1)->picture();
    const QPoint inBar(is.width() / 2, is.height() / 2);
    QVERIFY(qGreen(should.pixel(inBar)) > qGreen(is.pixel(inBar)) + 30);
    app.screenshot("frames_found");

    QTest::keyClick(&app.window(), Qt::Key_D);
    QVERIFY(app.workspace().undo().count() == 1);
    QTRY_COMPARE_WITH_TIMEOUT(droppedIn(app.path("ball")), std::vector<int>{77}, kLong);
    QTRY_VERIFY_WITH_TIMEOUT(list->item(row("Frame 77"))->text().endsWith("dropped"), kLong);
    const auto reason = Sketch::open(app.path("ball"))->frames()[77].dropReason;
    QVERIFY2(reason.starts_with("shadow over"), reason.c_str());

    app.workspace().undo().undo();
    QTRY_VERIFY_WITH_TIMEOUT(droppedIn(app.path("ball")).empty(), kLong);
    QTRY_VERIFY_WITH_TIMEOUT(!list->item(row("Frame 77"))->text().endsWith("dropped"), kLong);
    app.find<QPushButton>("dropShadows")->click();
    const std::vector<int> both{40, 77};
    const auto includes = [](const std::vector<int>& all, const std::vector<int>& some) {
      return std::ranges::includes(all, some);
    };
    QTRY_VERIFY_WITH_TIMEOUT(includes(droppedIn(app.path("ball")), both), kLong);
    app.workspace().undo().undo();
    app.workspace().undo().redo();  // faster than the disk
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().running(), 0, kLong);
    QTRY_VERIFY_WITH_TIMEOUT(includes(droppedIn(app.path("ball")), both), kLong);
    QTRY_VERIFY_WITH_TIMEOUT(app.find<QLabel>("sketchCounts")->text().contains("dropped"), kLong);
    app.screenshot("frames_dropped");

    // Kept after all.
    list->setCurrentRow(row("Frame 40"));
    app.find<QPushButton>("keepFrame")->click();
    QTRY_VERIFY_WITH_TIMEOUT(!includes(droppedIn(app.path("ball")), {40}), kLong);
    // Every step is an event in the journal, none was rewritten.
    QFile journal(toQString(app.path("ball") / "frames.jsonl"));
    QVERIFY(journal.open(QFile::ReadOnly));
    QCOMPARE(journal.readAll().count("\"drop\""), 1 + 2 * 2);
  }

  void aDroppedFrameOfYesterdayIsListedWithItsPicture() {
    AppTest app;
    BallSketch().write(app.path("ball"));
    QVERIFY(dropJob({app.path("ball"), {5}, "cat"}).has_value());
    app.workspace().open(app.path("ball"));
    app.find<QTabWidget>("developTabs")->setCurrentIndex(1);
    auto* list = app.find<QListWidget>("suspects");
    QTRY_COMPARE_WITH_TIMEOUT(list->count(), 1, kLong);
    list->setCurrentRow(0);
    QVERIFY(app.find<QLabel>("suspectReason")->text().contains("cat"));
    auto* pictures = app.find<TripleView>("suspectPictures");
    QTRY_VERIFY_WITH_TIMEOUT(!pictures->view(0)->picture().isNull(), kLong);
    app.find<QPushButton>("keepFrame")->click();
    QTRY_VERIFY_WITH_TIMEOUT(droppedIn(app.path("ball")).empty(), kLong);
  }

  void light() {
    AppTest app;
    app.workspace().settings().setValue("theme", "light");
    QVERIFY(open(app, {}));
    app.find<QToolButton>("advanced")->click();
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QListWidget>("thumbnails")->count(), 24, kLong);
    app.screenshot("develop_advanced");
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::DevelopPageTest)
#include "develop_page_test.moc"
