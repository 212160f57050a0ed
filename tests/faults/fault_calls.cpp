#include "tests/faults/fault_calls.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <ctime>

namespace {

std::atomic<bool> armed = false;
std::atomic<int> calls = 0;
int faultyCall = 0;
int action = FAULT_KILL;
std::atomic<int> delay = 0;
std::atomic<int> clockOffset = 0;
char countFile[4096];

[[noreturn]] void die() {
  ::raise(SIGKILL);
  ::_exit(137);
}

// Nothing: go on. Else what the call fails with; FAULT_KILL for a write that is to die half way.
enum class Verdict { kGoOn, kFail, kDie };
Verdict verdict() {
  if (!armed) return Verdict::kGoOn;
  const int call = ++calls;
  if (faultyCall == 0 || call < faultyCall) return Verdict::kGoOn;
  if (action == FAULT_KILL) return call == faultyCall ? Verdict::kDie : Verdict::kGoOn;
  if (action < 0 && call > faultyCall) return Verdict::kGoOn;
  errno = std::abs(action);
  return Verdict::kFail;
}

bool isFile(int fd) {
  struct stat status {};
  const int before = errno;
  const bool file =
      ::fstat(fd, &status) == 0 && (S_ISREG(status.st_mode) || S_ISDIR(status.st_mode));
  errno = before;
  return file;
}

void wait() {
  if (delay > 0) ::usleep(static_cast<useconds_t>(delay.load()));
}

// Dies or fails where it should.
bool fails() {
  switch (verdict()) {
    case Verdict::kGoOn:
      return false;
    case Verdict::kFail:
      return true;
    case Verdict::kDie:
      die();
  }
  return false;
}

template <class Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(::dlsym(RTLD_NEXT, name));
}

bool writes(int flags) { return (flags & (O_WRONLY | O_RDWR | O_CREAT)) != 0; }

__attribute__((constructor)) void armByEnvironment() {
  const char* wanted = std::getenv("LIGHTSKETCH_FAULT");
  if (wanted == nullptr) return;
  int call = 0;
  int what = 0;
  if (std::sscanf(wanted, "%d %d %4095s", &call, &what, countFile) >= 2) faultArm(call, what);
}

__attribute__((destructor)) void tellCount() {
  if (countFile[0] == '\0') return;
  armed = false;
  if (std::FILE* file = std::fopen(countFile, "w")) {
    std::fprintf(file, "%d\n", calls.load());
    std::fclose(file);
  }
}

}  // namespace

extern "C" {

void faultArm(int call, int what) {
  calls = 0;
  faultyCall = call;
  action = what;
  armed = true;
}
void faultDisarm() {
  armed = false;
  delay = 0;
  clockOffset = 0;
}
int faultCalls() { return calls; }
void faultDelay(int microseconds) { delay = microseconds; }
void faultClock(int seconds) { clockOffset = seconds; }

int clock_gettime(clockid_t clock, timespec* time) {
  static const auto real = next<int (*)(clockid_t, timespec*)>("clock_gettime");
  const int result = real(clock, time);
  if (result == 0 && clock == CLOCK_REALTIME) time->tv_sec += clockOffset;
  return result;
}

ssize_t write(int fd, const void* bytes, size_t count) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t)>("write");
  if (isFile(fd)) {
    wait();
    switch (verdict()) {
      case Verdict::kGoOn:
        break;
      case Verdict::kFail:
        return -1;
      case Verdict::kDie:
        (void)real(fd, bytes, count / 2);
        die();
    }
  }
  return real(fd, bytes, count);
}

ssize_t writev(int fd, const iovec* parts, int count) {
  static const auto real = next<ssize_t (*)(int, const iovec*, int)>("writev");
  if (isFile(fd) && fails()) return -1;
  return real(fd, parts, count);
}

ssize_t pwrite(int fd, const void* bytes, size_t count, off_t offset) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  if (isFile(fd) && fails()) return -1;
  return real(fd, bytes, count, offset);
}

int fsync(int fd) {
  static const auto real = next<int (*)(int)>("fsync");
  wait();
  return fails() ? -1 : real(fd);
}

int fdatasync(int fd) {
  static const auto real = next<int (*)(int)>("fdatasync");
  wait();
  return fails() ? -1 : real(fd);
}

int rename(const char* from, const char* to) {
  static const auto real = next<int (*)(const char*, const char*)>("rename");
  return fails() ? -1 : real(from, to);
}

int ftruncate(int fd, off_t length) {
  static const auto real = next<int (*)(int, off_t)>("ftruncate");
  return isFile(fd) && fails() ? -1 : real(fd, length);
}

int unlink(const char* path) {
  static const auto real = next<int (*)(const char*)>("unlink");
  return fails() ? -1 : real(path);
}

int mkdir(const char* path, mode_t mode) {
  static const auto real = next<int (*)(const char*, mode_t)>("mkdir");
  return fails() ? -1 : real(path, mode);
}

int open(const char* path, int flags, ...) {
  static const auto real = next<int (*)(const char*, int, ...)>("open");
  mode_t mode = 0;
  if (flags & (O_CREAT | O_TMPFILE)) {
    va_list rest;
    va_start(rest, flags);
    mode = va_arg(rest, mode_t);
    va_end(rest);
  }
  if (writes(flags) && fails()) return -1;
  return real(path, flags, mode);
}

}  // extern "C"
