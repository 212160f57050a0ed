// How failure travels: values, not exceptions. Leaf of the project; everything includes it.
#pragma once

#include <fmt/format.h>

#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace lightsketch {

enum class ErrorCode {
  kInvalidArgument,  // the caller asked for something that makes no sense
  kNotFound,         // a file, folder or camera is not there
  kCorrupt,          // a file is there but damaged or not what it claims to be
  kUnsupported,      // well formed, but this version cannot handle it
  kIo,               // reading or writing failed (disk full, permissions)
  kDevice,           // a camera refused or vanished
  kTimeout,
  kCancelled,
};

// `message` is one line for the user: what, where (file, line, field), what to do.
struct Error {
  ErrorCode code;
  std::string message;
};

template <class T>
using Result = tl::expected<T, Error>;

// return failure(ErrorCode::kCorrupt, "{}: line {}: not a number: '{}'", path, line, token);
template <class... Args>
tl::unexpected<Error> failure(ErrorCode code, fmt::format_string<Args...> format, Args&&... args) {
  return tl::unexpected<Error>(Error{code, fmt::format(format, std::forward<Args>(args)...)});
}

}  // namespace lightsketch

#define LIGHTSKETCH_CONCAT_INNER(a, b) a##b
#define LIGHTSKETCH_CONCAT(a, b) LIGHTSKETCH_CONCAT_INNER(a, b)

// ASSIGN_OR_RETURN(const auto model, loadCameraModel(path)): hands an error on to the caller.
#define ASSIGN_OR_RETURN(declaration, expression) \
  ASSIGN_OR_RETURN_INNER(LIGHTSKETCH_CONCAT(result_, __LINE__), declaration, expression)
#define ASSIGN_OR_RETURN_INNER(temporary, declaration, expression)                           \
  auto temporary = (expression);                                                             \
  if (!temporary) return tl::unexpected<::lightsketch::Error>(std::move(temporary).error()); \
  declaration = std::move(*temporary)

// RETURN_IF_ERROR(sketch.drop(id, reason)): for a Result<void>.
#define RETURN_IF_ERROR(expression)                                            \
  do {                                                                         \
    if (auto status_ = (expression); !status_)                                 \
      return tl::unexpected<::lightsketch::Error>(std::move(status_).error()); \
  } while (false)
