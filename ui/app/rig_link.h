// The cameras: which they are, their live pictures, and lending them to jobs.
#pragma once

#include <QObject>
#include <QString>
#include <QStringList>
#include <filesystem>
#include <functional>
#include <memory>
#include <vector>

#include "capture/device/camera.h"
#include "capture/rig/simulated_rig.h"
#include "pipeline/job/calibrate_jobs.h"
#include "pipeline/job/jobs.h"
#include "ui/app/live_view.h"

namespace lightsketch {

struct CalibrationFiles {
  std::filesystem::path sourceModel;    // of the source camera's lens; empty: not calibrated
  std::filesystem::path rigGeometry;    // empty: source camera upright at the subject
  std::filesystem::path sceneResponse;  // empty: a linear sensor
  std::filesystem::path sceneModel;     // of the scene camera's lens; only for near lamps
};

// What stands on the table. Remembered from one start to the next.
struct RigSetup : CalibrationFiles {
  bool simulated = true;    // the rig of this program, started by it
  SimulatedRigOptions rig;  // in that case
  std::string sceneCamera;  // addresses, else
  std::string sourceCamera;
  CameraSettings scene{
      PixelFormat::kBayerRG12, {}, 0.02, 0.0, 12.0, {}};  // as RecorderOptions has it
  CameraSettings source{{}, {}, 0.001, 0.0, 12.0, {}};
};

// Lives on the UI thread; opening, configuring and closing happen on a thread of its own, so that a
// camera that hangs blocks nobody.
class RigLink final : public QObject {
  Q_OBJECT
 public:
  enum class State { kClosed, kOpening, kLive, kLent, kFailed };

  explicit RigLink(QObject* parent = nullptr);
  ~RigLink() override;

  // Cameras found, asynchronously; found() tells.
  void search();
  const std::vector<CameraInfo>& cameras() const { return cameras_; }

  const RigSetup& setup() const { return setup_; }
  // Closes what is open and opens the new one (if somebody looks, see watch()).
  void setSetup(const RigSetup& setup);

  // How many pages want live pictures; with none the cameras are closed a moment later.
  void watch(bool on);
  // A closed or failed link is tried again.
  void reopen();
  // Calibration files that are used from now on; the cameras go on as they are.
  void setCalibration(const CalibrationFiles& files);
  // Settings of a running camera, which pauses for some of them; the answer comes as configured().
  // What it accepts, or what nobody is there to refuse, is remembered in setup().
  void configureScene(const CameraSettings& settings);
  void configureSource(const CameraSettings& settings);
  // What the cameras really use; empty while they are closed or lent.
  const CameraSettings& sceneSettings() const { return sceneSettings_; }
  const CameraSettings& sourceSettings() const { return sourceSettings_; }

  State state() const { return state_; }
  const QString& trouble() const { return trouble_; }  // of kFailed
  LiveView& sceneView() { return *sceneView_; }
  LiveView& sourceView() { return *sourceView_; }
  StreamStatistics sceneStatistics() const;
  StreamStatistics sourceStatistics() const;

  // For jobs, which open the cameras themselves: call lend() on the UI thread, give the job
  // opener() and call giveBack() when it has ended. The preview is closed before the job's first
  // camera opens; the live views show the job's frames. Nested lending is a logic error.
  void lend();
  void giveBack();
  CameraOpener opener();
  // A recording with the addresses, models, settings and the opener of this rig filled in.
  RecordJob recordJob();
  std::string sceneAddress() const { return sceneAddress(setup_); }
  std::string sourceAddress() const { return sourceAddress(setup_); }
  // Of the source camera's lens; a simulated rig brings its own. Empty: none.
  std::filesystem::path sourceModel() const;
  std::filesystem::path rigGeometry() const;

 Q_SIGNALS:
  void found();
  void stateChanged();
  void setupChanged();
  // What the camera really uses now (also when it was opened), or why it does not.
  void configured(bool sceneCamera, const QString& answer, bool ok);

 private:
  class Worker;
  static std::string sceneAddress(const RigSetup& setup);
  static std::string sourceAddress(const RigSetup& setup);
  void configure(bool scene, const CameraSettings& settings);
  void tell(bool scene, const Result<CameraSettings>& now);
  void apply(State state, const QString& trouble);

  RigSetup setup_;
  std::vector<CameraInfo> cameras_;
  State state_ = State::kClosed;
  QString trouble_;
  CameraSettings sceneSettings_;
  CameraSettings sourceSettings_;
  int watchers_ = 0;
  int attempt_ = 0;  // to open; what comes of an earlier one counts no more
  std::shared_ptr<LiveView> sceneView_;
  std::shared_ptr<LiveView> sourceView_;
  std::shared_ptr<Worker> worker_;
};

}  // namespace lightsketch
