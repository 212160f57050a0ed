// lightsketch-app [SKETCH|MODEL|FOLDER]
#include <QCommandLineParser>
#include <QDeadlineTimer>
#include <QMouseEvent>
#include <QTimer>
#include <QWindow>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string_view>

#include "ui/app/application.h"
#include "ui/app/main_window.h"
#include "ui/app/relight_page.h"

namespace lightsketch {
namespace {

// A hand that moves the mouse to and fro over the relit picture, its button held, with the 125
// reports a second of a plain mouse.
void dragOver(RelightView& view) {
  auto* hand = new QTimer(&view);
  hand->setTimerType(Qt::PreciseTimer);
  const auto send = [&view](QEvent::Type type, int step) {
    const int half = view.width() / 4;
    const QPointF at(view.width() / 2 - half + std::abs(4 * step % (4 * half) - 2 * half),
                     view.height() / 2);
    QMouseEvent event(type, at, view.mapToGlobal(at),
                      type == QEvent::MouseMove ? Qt::NoButton : Qt::LeftButton, Qt::LeftButton,
                      Qt::NoModifier);
    QCoreApplication::sendEvent(&view, &event);
  };
  QObject::connect(hand, &QTimer::timeout, &view, [send, step = 0]() mutable {
    send(step == 0 ? QEvent::MouseButtonPress : QEvent::MouseMove, step);
    ++step;
  });
  hand->start(8);
}

// One line, and the exit code of bad input.
int refuse(const QString& why) {
  std::fprintf(stderr, "lightsketch-app: %s\n", qPrintable(why));
  return 1;
}

// Help and version need no display.
bool asksForWords(int argc, char** argv) {
  return std::any_of(argv + 1, argv + argc, [](const std::string_view argument) {
    return argument == "-h" || argument == "--help" || argument == "--help-all" ||
           argument == "-v" || argument == "--version";
  });
}

}  // namespace
}  // namespace lightsketch

int main(int argc, char** argv) {
  using namespace lightsketch;
  QCoreApplication::setApplicationName("lightsketch-app");
  QCoreApplication::setOrganizationName("lightsketch");
  QCoreApplication::setApplicationVersion(LIGHTSKETCH_VERSION);

  QCommandLineParser parser;
  parser.setApplicationDescription(
      "Wave a lamp around a scene, see the covered light directions fill up, and get a picture "
      "that can be lit by anything. Without cameras a simulated rig is used.");
  parser.addHelpOption();
  parser.addVersionOption();
  parser.addPositionalArgument("file", "a sketch, a model (.lsd), or a folder with a .lp file",
                               "[SKETCH|MODEL|FOLDER]");
  const QCommandLineOption page(
      "page", "Begin with this page: rig, calibrate, sketch, develop, relight, validate.", "NAME");
  const QCommandLineOption begin("begin", "Press the page's main button at once.");
  const QCommandLineOption light(
      "light", "Relight page: begin with lamp, three-lamps, surroundings, room or path.", "NAME");
  const QCommandLineOption drag("drag", "Relight page: drag over the picture as a mouse would.");
  const QCommandLineOption seconds("for", "Quit after so many seconds.", "S");
  const QCommandLineOption picture(
      "picture", "Before it quits, save what the window shows to this file.", "FILE");
  const QCommandLineOption stats(
      "stats",
      "When it ends, print frame rates, latencies, dropped frames and how long the user "
      "interface was blocked.");
  const QCommandLineOption frames(
      "rig-frames", "Simulated rig: serve so many frames rendered beforehand, in a loop.", "N",
      "0");
  const QCommandLineOption rate("rig-rate", "Frames a second of both cameras.", "F");
  const QCommandLineOption addresses(
      "rig-addresses", "Simulated rig: loopback addresses of scene and source camera.", "A,B");
  const QCommandLineOption scene("scene", "Scene camera, e.g. aravis:192.168.1.20.", "ADDRESS");
  const QCommandLineOption source("source", "Source camera, e.g. aravis:192.168.1.21.", "ADDRESS");
  const QCommandLineOption model("camera-model", "The source camera's lens, of a calibration.",
                                 "FILE");
  const QCommandLineOption geometry("rig", "Where the cameras stand, of a calibration.", "FILE");
  const QCommandLineOption settings("settings", "Keep the settings in this file.", "FILE");
  parser.addOptions({page, begin, light, drag, seconds, picture, stats, frames, rate, addresses,
                     scene, source, model, geometry, settings});
  if (asksForWords(argc, argv)) parser.process(QCoreApplication(argc, argv));  // ends here
  Application application(argc, argv);
  parser.process(application);
  bool whole = false;
  const int rigFrames = parser.value(frames).toInt(&whole);
  if (!whole || rigFrames < 0) {
    return refuse("--rig-frames " + parser.value(frames) + ": not a count of frames, e.g. 150");
  }
  const auto number = [&parser](const QCommandLineOption& option) {
    bool valid = false;
    const double value = parser.value(option).toDouble(&valid);
    return valid && std::isfinite(value) ? value : -1;
  };
  const double framesPerSecond = number(rate);
  if (parser.isSet(rate) && framesPerSecond <= 0) {
    return refuse("--rig-rate " + parser.value(rate) +
                  ": not a number of frames a second, e.g. 30");
  }
  const double runSeconds = number(seconds);
  if (parser.isSet(seconds) && runSeconds < 0) {
    return refuse("--for " + parser.value(seconds) + ": not a number of seconds, e.g. 12");
  }
  if (parser.isSet(scene) != parser.isSet(source)) {
    return refuse("--scene and --source go together: name both cameras or none");
  }
  const QStringList rigAddresses = parser.value(addresses).split(',', Qt::SkipEmptyParts);
  if (parser.isSet(addresses) && rigAddresses.size() != 2) {
    return refuse("--rig-addresses " + parser.value(addresses) +
                  ": two addresses with a comma between, e.g. 127.0.0.21,127.0.0.22");
  }

  Workspace workspace(parser.value(settings));
  RigSetup setup = workspace.rig().setup();
  if (parser.isSet(scene)) {
    setup.simulated = false;
    setup.sceneCamera = parser.value(scene).toStdString();
    setup.sourceCamera = parser.value(source).toStdString();
    setup.sourceModel = toPath(parser.value(model));
    setup.rigGeometry = toPath(parser.value(geometry));
    if (parser.isSet(rate)) {
      setup.scene.framesPerSecond = setup.source.framesPerSecond = framesPerSecond;
    }
    workspace.rig().setSetup(setup);
  } else if (setup.simulated) {
    setup.rig.prerenderedFrames = rigFrames;
    if (parser.isSet(rate)) {
      setup.rig.framesPerSecond = framesPerSecond;
      setup.scene.framesPerSecond = setup.source.framesPerSecond = setup.rig.framesPerSecond;
    }
    if (!rigAddresses.isEmpty()) {
      setup.rig.sceneAddress = rigAddresses[0].toStdString();
      setup.rig.sourceAddress = rigAddresses[1].toStdString();
    }
    workspace.rig().setSetup(setup);
  }
  int code = 0;
  {
    // A file has a page of its own.
    const bool file = !parser.positionalArguments().isEmpty();
    MainWindow window(workspace, parser.isSet(page) ? parser.value(page) : file ? "" : "rig");
    if (parser.isSet(page) && !window.page(parser.value(page))) {
      return refuse("--page " + parser.value(page) +
                    ": no such page; one of rig, calibrate, sketch, develop, relight, validate");
    }
    window.show();
    // The first picture of the window loads fonts and style; nobody can wait for it yet.
    for (QDeadlineTimer patience(2000); !window.windowHandle()->isExposed();) {
      if (patience.hasExpired()) break;
      QCoreApplication::processEvents(QEventLoop::AllEvents, 10);
    }
    application.watch(workspace.statistics());
    if (file && !workspace.open(toPath(parser.positionalArguments().front()))) {
      std::fprintf(stderr, "lightsketch-app: %s: cannot be opened\n",
                   qPrintable(parser.positionalArguments().front()));
    }
    if (parser.isSet(page)) window.showPage(parser.value(page));
    if (!window.currentPage()) window.showPage("rig");
    if (parser.isSet(light) || parser.isSet(drag)) {
      auto& relight = static_cast<RelightPage&>(*window.page("relight"));
      if (!parser.value(light).isEmpty() && !relight.setLight(parser.value(light))) {
        return refuse("--light " + parser.value(light) +
                      ": no such light; one of lamp, three-lamps, surroundings, room, path");
      }
      if (parser.isSet(drag)) dragOver(relight.view());
    }
    if (parser.isSet(begin)) {
      QTimer::singleShot(0, &window, [&] { window.currentPage()->begin(); });
    }
    if (parser.isSet(seconds)) {
      QTimer::singleShot(static_cast<int>(1000 * runSeconds), &window, [&] {
        application.unwatch();  // closing waits for what runs
        if (parser.isSet(picture)) window.grab().save(parser.value(picture));
        window.close();
      });
    }
    code = application.exec();
  }
  if (parser.isSet(stats)) std::fputs(workspace.statistics().describe().c_str(), stdout);
  return code;
}
