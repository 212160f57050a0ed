#include <QComboBox>
#include <QFile>
#include <QLabel>
#include <QPushButton>
#include <QTableView>
#include <QTest>

#include "capture/frame/file.h"
#include "capture/frame/json.h"
#include "tests/ui/app/app_test.h"
#include "tests/ui/app/ball_sketch.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/picture_view.h"
#include "ui/app/validate_page.h"

namespace lightsketch {

constexpr int kLong = patience(60000);  // for what takes a second on an idle machine

class ValidatePageTest : public QObject {
  Q_OBJECT

  static ValidatePage& page(AppTest& app) {
    return *static_cast<ValidatePage*>(app.window().page("validate"));
  }
  // A ball, developed as the Develop page does.
  static std::filesystem::path model(AppTest& app, const std::string& holdOut = "every:8:4") {
    BallSketch().write(app.path("ball"));
    CompressJob job;
    job.sketch = app.path("ball");
    job.out = app.path("ball.lsd");
    job.options.holdOutRule = holdOut;
    SilentProgress quiet;
    return compressJob(job, quiet) ? job.out : std::filesystem::path();
  }
  static bool validate(AppTest& app) {
    app.window().showPage("validate");
    auto* button = app.find<QPushButton>("validate");
    if (!QTest::qWaitFor([&] { return button->isEnabled(); }, kLong)) return false;
    button->click();
    return QTest::qWaitFor([&] { return app.find<QTableView>("lights")->model()->rowCount() > 0; },
                           kLong);
  }
  static Json reportOf(AppTest& app) {
    return readJsonFile(app.workspace().report() / "report.json").value();
  }
  static bool pictures(AppTest& app) {
    auto* view = app.find<TripleView>("lightPictures");
    return QTest::qWaitFor([&] { return !view->view(2)->picture().isNull(); }, kLong);
  }

 private Q_SLOTS:
  void saysWhatToDoWithoutASketch() {
    AppTest app;
    app.window().showPage("validate");
    QVERIFY(!app.find<QPushButton>("validate")->isEnabled());
    QVERIFY(app.find<QLabel>("validateAdvice")->text().contains("Record one"));
    app.screenshot("validate_empty");
  }

  void showsTheNumbersOfTheReport() {
    AppTest app;
    const auto file = model(app);
    app.workspace().setSketch(app.path("ball"));
    app.workspace().setModel(file);
    app.window().showPage("validate");
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QComboBox>("subject")->currentText(), "ball.lsd", kLong);
    QVERIFY(validate(app));
    QCOMPARE(app.workspace().report(), app.path("ball-report"));
    const Json report = reportOf(app);
    const QString text = app.find<QLabel>("figures")->text();
    for (const char* group : {"mean", "insideHull", "outsideHull"}) {
      const Json& mean = report.at(group);
      if (mean.at("count").get<int>() == 0) continue;
      for (const auto& [name, scale, digits] :
           {std::tuple{"psnrDb", 1, 2}, {"ssim", 1, 4}, {"relativeError", 100, 2}}) {
        const QString number = QString::number(scale * mean.at(name).get<double>(), 'f', digits);
        QVERIFY2(text.contains(">" + number + "<"), qPrintable(number + " in " + text));
      }
    }
    for (const char* id : {"worst", "median", "best"})
      QVERIFY(text.contains(QString("#%1<").arg(report.at(id).get<int>())));
    // Worst first, and its pictures are there without a click.
    const auto* rows = app.find<QTableView>("lights")->model();
    QCOMPARE(rows->rowCount(), 15);
    QCOMPARE(rows->index(0, 0).data().toInt(), report.at("worst").get<int>());
    QCOMPARE(rows->index(14, 0).data().toInt(), report.at("best").get<int>());
    QVERIFY(pictures(app));
    app.screenshot("validate");
  }

  void aClickOnADotShowsItsPictures() {
    AppTest app;
    const auto file = model(app);
    app.workspace().setSketch(app.path("ball"));
    app.workspace().setModel(file);
    QVERIFY(validate(app));
    QVERIFY(pictures(app));
    auto* map = app.find<HemisphereView>("errorMap");
    QTRY_VERIFY_WITH_TIMEOUT(map->dots().size() == 15u + 105u, kLong);  // and those captured
    const Json light = reportOf(app).at("lights").at(7);
    const auto xyz = light.at("direction").get<std::vector<double>>();
    auto* view = app.find<TripleView>("lightPictures");
    const qint64 before = view->view(0)->picture().cacheKey();
    QTest::mouseClick(map, Qt::LeftButton, {}, map->project({xyz[0], xyz[1], xyz[2]}).toPoint());
    QVERIFY(app.find<QLabel>("lightCaption")
                ->text()
                .contains(QString("Frame %1<").arg(light.at("id").get<int>())));
    QTRY_VERIFY_WITH_TIMEOUT(view->view(0)->picture().cacheKey() != before, kLong);
    // The difference is four times that of the other two, where it is not clipped.
    const QImage truth = view->view(0)->picture();
    const QImage relit = view->view(1)->picture();
    const QImage difference = view->view(2)->picture();
    for (int y = 0; y < truth.height(); y += 7) {
      for (int x = 0; x < truth.width(); x += 7) {
        const int d = std::abs(qRed(truth.pixel(x, y)) - qRed(relit.pixel(x, y)));
        QCOMPARE(qRed(difference.pixel(x, y)), std::min(255, 4 * d));
      }
    }
    // One of them large, and all again.
    QTest::keyClick(view, Qt::Key_3);
    QVERIFY(view->view(2)->isVisible() && !view->view(0)->isVisible());
    app.screenshot("validate_large");
    QTest::keyClick(view, Qt::Key_Escape);
    QVERIFY(view->view(0)->isVisible());
  }

  void theKeyboardGoesFromWorstToBest() {
    AppTest app;
    const auto file = model(app);
    app.workspace().setSketch(app.path("ball"));
    app.workspace().setModel(file);
    QVERIFY(validate(app));
    auto* table = app.find<QTableView>("lights");
    table->sortByColumn(0, Qt::DescendingOrder);  // whatever the table is sorted by
    std::vector<double> psnr;
    const auto now = [&] {
      return table->model()->index(table->currentIndex().row(), 1).data().toDouble();
    };
    psnr.push_back(now());
    for (int i = 0; i < 14; ++i) {
      QTest::keyClick(&app.window(), Qt::Key_Right, Qt::ControlModifier);
      psnr.push_back(now());
    }
    QVERIFY(std::ranges::is_sorted(psnr));
    QVERIFY(psnr.front() < psnr.back());
    QVERIFY(!app.find<QPushButton>("better")->isEnabled());
    QTest::keyClick(&app.window(), Qt::Key_Left, Qt::ControlModifier);
    QCOMPARE(now(), psnr[13]);
  }

  void aModelThatSawEveryFrameIsReplacedByANewOne() {
    AppTest app;
    const auto file = model(app, "");
    app.workspace().setSketch(app.path("ball"));
    app.workspace().setModel(file);
    app.window().showPage("validate");
    QTRY_VERIFY_WITH_TIMEOUT(
        app.find<QLabel>("validateAdvice")->text().contains("has seen every frame"), kLong);
    app.screenshot("validate_advice");
    auto* rule = app.find<QComboBox>("holdOutRule");
    rule->setCurrentIndex(rule->findData("every:4:2"));
    QVERIFY(validate(app));
    QCOMPARE(reportOf(app).at("holdOut").get<std::string>(), std::string("every:4:2"));
    QVERIFY(std::filesystem::exists(app.path("ball-report") / "model.lsd"));
    QVERIFY(pictures(app));
  }

  void aReportOfYesterdayIsShownAgain() {
    AppTest app;
    const auto file = model(app);
    ValidateJob job;
    job.sketch = app.path("ball");
    job.model = file;
    job.report = app.path("report");
    SilentProgress quiet;
    QVERIFY(validateJob(job, quiet).has_value());
    QVERIFY(app.workspace().open(app.path("report")));
    QCOMPARE(app.window().currentPage(), app.window().page("validate"));
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QTableView>("lights")->model()->rowCount(), 15, kLong);
    QVERIFY(pictures(app));

    // Its model gone: the figures stay, and it is said why there are no pictures.
    std::filesystem::remove(file);
    app.workspace().setReport(app.path("report"));
    QTRY_VERIFY_WITH_TIMEOUT(app.find<TripleView>("lightPictures")->view(0)->picture().isNull(),
                             kLong);
    QTRY_COMPARE_WITH_TIMEOUT(app.find<QTableView>("lights")->model()->rowCount(), 15, kLong);
    app.screenshot("validate_without_model");
  }

  void whatIsNoReportIsSaid() {
    AppTest app;
    app.window().showPage("validate");
    std::filesystem::create_directories(app.path("odd"));
    QVERIFY(writeFileAtomically(app.path("odd") / "report.json", "{}").has_value());
    app.workspace().setReport(app.path("odd"));
    QTRY_VERIFY_WITH_TIMEOUT(app.banner("report").contains("odd"), kLong);
  }

  void exportsReadBack() {
    AppTest app;
    const auto file = model(app);
    app.workspace().setSketch(app.path("ball"));
    app.workspace().setModel(file);
    QVERIFY(validate(app));
    page(app).exportFigures(app.path("out.csv"));
    page(app).exportDirections(app.path("out.lp"));
    page(app).exportPictures(app.path("out"));
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().running(), 0, kLong);

    const Json report = reportOf(app);
    const QStringList lines =
        QString::fromStdString(readFile(app.path("out.csv")).value()).trimmed().split('\n');
    QCOMPARE(lines.size(), 16);
    const auto psnr = lines.front().split(',').indexOf("psnr_db");
    for (int i = 0; i < 15; ++i) {
      const QStringList fields = lines[i + 1].split(',');
      const Json& light = report.at("lights").at(static_cast<std::size_t>(i));
      QCOMPARE(fields.front().toInt(), light.at("id").get<int>());
      QVERIFY(std::abs(fields[psnr].toDouble() - light.at("psnrDb").get<double>()) < 1e-3);
    }
    const QStringList lp =
        QString::fromStdString(readFile(app.path("out.lp")).value()).trimmed().split('\n');
    QCOMPARE(lp.front(), "120");
    QCOMPARE(lp.size(), 121);
    QVERIFY(std::filesystem::exists(app.path("out") / "dirs.lp"));
    app.workspace().open(app.path("out"));  // and comes in again
    QTRY_COMPARE_WITH_TIMEOUT(app.workspace().sketch(), app.path("out.sketch"), kLong);
  }

  void cancelLeavesNoReport() {
    AppTest app;
    BallSketch().write(app.path("ball"));
    app.workspace().setSketch(app.path("ball"));
    app.window().showPage("validate");
    auto* button = app.find<QPushButton>("validate");
    QTRY_VERIFY(button->isEnabled());
    button->click();
    QCOMPARE(button->text(), "Cancel");
    button->click();
    QTRY_COMPARE_WITH_TIMEOUT(button->text(), "Validate", kLong);
    QVERIFY(!std::filesystem::exists(app.path("ball-report")));
    QVERIFY(app.workspace().report().empty());
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::ValidatePageTest)
#include "validate_page_test.moc"
