// For the thread sanitizer, which cannot look into Qt: what is posted to a thread with
// QMetaObject::invokeMethod happens before it is called there. The linker sends calls of
// invokeMethod here first (tests/ui/app/CMakeLists.txt).
#include <dlfcn.h>

#include <cstdarg>

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

// Posted in the place of a call.
class OrderedSlot final : public QtPrivate::QSlotObjectBase {
 public:
  explicit OrderedSlot(QSlotObjectBase* inner) : QSlotObjectBase(act), inner_(inner) {
    __tsan_release(this);
  }

 private:
  static void act(int which, QSlotObjectBase* self, QObject* receiver, void** arguments, bool*) {
    auto* const own = static_cast<OrderedSlot*>(self);
    __tsan_acquire(own);
    if (which == Call) own->inner_->call(receiver, arguments);
    if (which == Destroy) {
      own->inner_->destroyIfLastRef();
      delete own;
    } else {
      __tsan_release(own);  // whoever lets go of it last destroys it
    }
  }

  QSlotObjectBase* inner_;
};

}  // namespace

bool __wrap__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
    QObject* object, QtPrivate::QSlotObjectBase* slot, Qt::ConnectionType type, void* result) {
  return __real__ZN11QMetaObject16invokeMethodImplEP7QObjectPN9QtPrivate15QSlotObjectBaseEN2Qt14ConnectionTypeEPv(
      object, new OrderedSlot(slot), type, result);
}

// QProcess starts programs as vfork does. The sanitizer's own clone takes such a child for one with
// its memory to itself, after which the parent fails the sanitizer's checks.
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
