// What one hears while one looks at the lamp and not at the screen.
#pragma once

#include <QObject>
#include <QThread>

namespace lightsketch {

// Short tones, made when they are needed. A thread of its own finds the audio device, which may
// take seconds; without one there is silence and no word about it. UI thread.
class Sounds final : public QObject {
  Q_OBJECT
 public:
  enum class Tone { kCaptured, kRefused, kLampLost, kDone };

  explicit Sounds(QObject* parent = nullptr);
  ~Sounds() override;

  void setMuted(bool muted);
  bool muted() const { return muted_; }
  // A tone that comes while another sounds is left out.
  void play(Tone tone);

 private:
  class Player;
  bool muted_ = false;
  QThread thread_;
  Player* player_ = nullptr;  // lives on thread_; made with the first tone
};

}  // namespace lightsketch
