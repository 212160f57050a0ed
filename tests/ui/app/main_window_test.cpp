#include <QMenuBar>
#include <QProcess>
#include <QProcessEnvironment>
#include <QSignalSpy>
#include <QTemporaryDir>
#include <QTest>
#include <fstream>
#include <thread>

#include "tests/ui/app/app_test.h"
#include "ui/app/hemisphere_view.h"

namespace lightsketch {

class MainWindowTest : public QObject {
  Q_OBJECT

 private Q_SLOTS:
  void everyPageIsReachedByItsKey() {
    AppTest app;
    const QStringList names{"rig", "calibrate", "sketch", "develop", "relight", "validate"};
    for (int i = 0; i < names.size(); ++i) {
      QTest::keyClick(&app.window(), static_cast<Qt::Key>(Qt::Key_1 + i), Qt::ControlModifier);
      QCOMPARE(app.window().currentPage(), app.window().page(names[i]));
    }
  }

  void whatCannotBeOpenedBecomesAMessage() {
    AppTest app;
    std::ofstream(app.path("nothing.txt")) << "nothing";
    QVERIFY(!app.workspace().open(app.path("nothing.txt")));
    QVERIFY(app.banner("open").contains("nothing.txt"));
  }

  void aTaskShowsProgressAndIsCancelledFromTheStatusBar() {
    AppTest app;
    Task* task = app.workspace().run("Count", [](Progress& progress, std::stop_token) {
      for (std::size_t i = 0; !progress.cancelled(); ++i) {
        progress.update("counting", i % 100, 100);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      return Result<JobResult>(failure(ErrorCode::kCancelled, "cancelled"));
    });
    QSignalSpy progressed(task, &Task::progressed);
    QVERIFY(progressed.wait(2000));
    QCOMPARE(progressed.front().front().toString(), "counting");
    QSignalSpy finished(task, &Task::finished);
    task->cancel();
    QVERIFY(finished.wait(2000));
    QVERIFY(task->cancelled());
    QVERIFY2(app.banner("task/Count").isEmpty(), "a cancelled task is no error");
  }

  void aFailedTaskBecomesAMessage() {
    AppTest app;
    Task* task = app.workspace().run("Fail", [](Progress&, std::stop_token) {
      return Result<JobResult>(failure(ErrorCode::kIo, "disk full"));
    });
    QSignalSpy finished(task, &Task::finished);
    QVERIFY(finished.wait(2000));
    QCOMPARE(app.banner("task/Fail"), "disk full");
  }

  void directionsComeBackFromTheHemisphere() {
    HemisphereView view;
    view.resize(400, 300);
    for (const bool whole : {false, true}) {
      view.setWholeSphere(whole);
      for (const Eigen::Vector3d& direction :
           {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.6, 0, 0.8), Eigen::Vector3d(-0.3, 0.9, 0.1),
            Eigen::Vector3d(0.1, -0.2, 0.4)}) {
        const auto back = view.unproject(view.project(direction));
        QVERIFY(back.has_value());
        QVERIFY((*back - direction.normalized()).norm() < 1e-9);
      }
    }
    view.setWholeSphere(false);
    // +y is up on the screen, and the rim is the horizon.
    QVERIFY(view.project({0, 1, 0}).y() < view.project({0, 0, 1}).y());
    QVERIFY(!view.unproject({1, 1}).has_value());
  }

  void theProgramRefusesWhatItCannotDo_data() {
    QTest::addColumn<QStringList>("arguments");
    QTest::addColumn<QString>("says");
    QTest::newRow("page") << QStringList{"--page", "attic"} << "--page attic: no such page";
    QTest::newRow("light") << QStringList{"--light", "candle"} << "--light candle: no such light";
    QTest::newRow("word") << QStringList{"--for", "ever"} << "--for ever: not a number";
    QTest::newRow("half") << QStringList{"--rig-frames", "1.5"} << "--rig-frames 1.5: not a count";
    QTest::newRow("zero") << QStringList{"--rig-rate", "0"} << "--rig-rate 0: not a number";
    QTest::newRow("negative") << QStringList{"--rig-rate", "-3"} << "--rig-rate -3: not a number";
    QTest::newRow("infinite") << QStringList{"--for", "inf"} << "--for inf: not a number";
    QTest::newRow("one camera") << QStringList{"--scene", "aravis:10.0.0.2"} << "go together";
    QTest::newRow("one address") << QStringList{"--rig-addresses", "127.0.0.21"} << "two addresses";
    QTest::newRow("option") << QStringList{"--brighter"} << "Unknown option 'brighter'";
  }

  void theProgramRefusesWhatItCannotDo() {
    QFETCH(QStringList, arguments);
    QFETCH(QString, says);
    const QTemporaryDir folder;
    QProcess program;
    program.start(LIGHTSKETCH_BINARY "-app",
                  arguments + QStringList{"--settings", folder.filePath("settings.ini")});
    QVERIFY(program.waitForFinished(patience(30'000)));
    QCOMPARE(program.exitCode(), 1);
    const QString error = program.readAllStandardError();
    QVERIFY2(error.contains(says), qPrintable(error));
    QVERIFY2(program.readAllStandardOutput().isEmpty(), "a complaint goes to standard error");
  }

  void helpNeedsNoDisplay() {
    QProcess program;
    auto environment = QProcessEnvironment::systemEnvironment();
    environment.remove("DISPLAY");
    program.setProcessEnvironment(environment);
    program.start(LIGHTSKETCH_BINARY "-app", {"--help"});
    QVERIFY(program.waitForFinished(patience(30'000)));
    QCOMPARE(program.exitCode(), 0);
    QVERIFY(program.readAllStandardOutput().contains("[SKETCH|MODEL|FOLDER]"));
  }
};

}  // namespace lightsketch

QTEST_MAIN(lightsketch::MainWindowTest)
#include "main_window_test.moc"
