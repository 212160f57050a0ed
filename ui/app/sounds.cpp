#include "ui/app/sounds.h"

#include <QAudioFormat>
#include <QAudioSink>
#include <QByteArray>
#include <QFileInfo>
#include <QLoggingCategory>
#include <QMediaDevices>
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

namespace lightsketch {
namespace {

constexpr int kSampleRate = 44100;
constexpr int kBufferMilliseconds = 500;  // the longest tone and a little

struct Note {
  double hertz;
  double seconds;
};

// Heard apart without being looked for: captured is high and short, refused low, lost falls.
std::vector<Note> notesOf(Sounds::Tone tone) {
  switch (tone) {
    case Sounds::Tone::kCaptured:
      return {{1320, 0.05}};
    case Sounds::Tone::kRefused:
      return {{196, 0.14}};
    case Sounds::Tone::kLampLost:
      return {{523, 0.12}, {349, 0.2}};
    case Sounds::Tone::kDone:
      return {{523, 0.12}, {659, 0.12}, {784, 0.2}};
  }
  return {};
}

QByteArray samplesOf(Sounds::Tone tone) {
  QByteArray bytes;
  for (const Note& note : notesOf(tone)) {
    const int count = static_cast<int>(note.seconds * kSampleRate);
    for (int i = 0; i < count; ++i) {
      const double t = static_cast<double>(i) / kSampleRate;
      // Up in 3 ms, then fading, so that nothing clicks.
      const double loudness = 0.3 * std::min(1.0, t / 0.003) * std::pow(1 - t / note.seconds, 1.5);
      const auto value = static_cast<std::int16_t>(32767 * loudness *
                                                   std::sin(2 * std::numbers::pi * note.hertz * t));
      bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
    }
  }
  return bytes;
}

// Qt says on the console where it looked in vain for a sound server; better not to ask it then.
bool soundServerThere() {
  if (qEnvironmentVariableIsSet("PULSE_SERVER")) return true;
  const QString folder = qEnvironmentVariable("PULSE_RUNTIME_PATH",
                                              qEnvironmentVariable("XDG_RUNTIME_DIR") + "/pulse");
  return QFileInfo::exists(folder + "/native");
}

}  // namespace

class Sounds::Player final : public QObject {
 public:
  void play(Tone tone) {
    if (!asked_) open();
    if (!device_) return;
    const QByteArray samples = samplesOf(tone);
    // Less than all free: another tone still sounds.
    if (sink_->bytesFree() < sink_->bufferSize() * 9 / 10) return;
    device_->write(samples);
  }

 private:
  void open() {
    asked_ = true;
    if (!soundServerThere()) return;
    const QAudioDevice output = QMediaDevices::defaultAudioOutput();
    if (output.isNull()) return;
    QAudioFormat format;
    format.setSampleRate(kSampleRate);
    format.setChannelCount(1);
    format.setSampleFormat(QAudioFormat::Int16);
    if (!output.isFormatSupported(format)) return;
    sink_ = std::make_unique<QAudioSink>(output, format);
    sink_->setBufferSize(format.bytesForDuration(1000 * kBufferMilliseconds));
    device_ = sink_->start();
  }

  bool asked_ = false;
  std::unique_ptr<QAudioSink> sink_;
  QIODevice* device_ = nullptr;  // sink_'s
};

Sounds::Sounds(QObject* parent) : QObject(parent) {
  // A computer without sound is nothing to complain about on the console.
  QLoggingCategory::setFilterRules("qt.multimedia*=false");
}

Sounds::~Sounds() {
  thread_.quit();
  thread_.wait();
}

void Sounds::setMuted(bool muted) { muted_ = muted; }

void Sounds::play(Tone tone) {
  if (muted_) return;
  if (!player_) {
    player_ = new Player;
    player_->moveToThread(&thread_);
    connect(&thread_, &QThread::finished, player_, &QObject::deleteLater);
    thread_.start();
  }
  QMetaObject::invokeMethod(player_, [player = player_, tone] { player->play(tone); });
}

}  // namespace lightsketch
