// For the thread sanitizer, which cannot look into Qt: what is posted to a thread with
// QMetaObject::invokeMethod happens before every event that is delivered after it. The linker sends
// calls of invokeMethod here first (CMakeLists.txt).
#include <dlfcn.h>

#include <cstdarg>

#include <QCoreApplication>
#include <QMetaObject>
#include <QObject>

extern "C" {
void __tsan_acquire(void* address);
void __tsan_release(void* address);
bool __real__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
    QObject* object, QtPrivate::QSlotObjectBase* slot, Qt::ConnectionType type, void* result);
bool __wrap__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
    QObject* object, QtPrivate::QSlotObjectBase* slot, Qt::ConnectionType type, void* result);
}

namespace {

int posts;

class EventOrder final : public QObject {
 public:
  using QObject::QObject;
  bool eventFilter(QObject*, QEvent*) override {
    __tsan_acquire(&posts);
    return false;
  }
};

void install() {
  QCoreApplication::instance()->installEventFilter(new EventOrder(QCoreApplication::instance()));
}

}  // namespace

Q_COREAPP_STARTUP_FUNCTION(install)

bool __wrap__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
    QObject* object, QtPrivate::QSlotObjectBase* slot, Qt::ConnectionType type, void* result) {
  __tsan_release(&posts);
  return __real__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
      object, slot, type, result);
}

// QProcess starts programs as vfork does. The sanitizer's own clone takes such a child for one with its
// memory to itself, after which the parent fails the sanitizer's checks.
extern "C" int clone(int (*run)(void*), void* stack, int flags, void* argument, ...) {
  using Clone = int (*)(int (*)(void*), void*, int, void*, ...);
  static const auto real = reinterpret_cast<Clone>(dlsym(RTLD_NEXT, "clone"));
  va_list rest;
  va_start(rest, argument);
  void* const parentId = va_arg(rest, void*);
  void* const storage = va_arg(rest, void*);
  void* const childId = va_arg(rest, void*);
  va_end(rest);
  return real(run, stack, flags, argument, parentId, storage, childId);
}
