// Runs something in a process of its own that dies or fails at one of its system calls.
#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <functional>

#include "tests/faults/fault_calls.h"

namespace lightsketch {

enum class CallOutcome {
  kKilled,    // at the call
  kFinished,  // there were fewer calls
  kBroken,    // it ended otherwise
};

inline CallOutcome dieAtCall(int call, const std::function<void()>& work) {
  const pid_t child = ::fork();
  if (child == 0) {
    faultArm(call, FAULT_KILL);
    work();
    ::_exit(0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) return CallOutcome::kKilled;
  return WIFEXITED(status) && WEXITSTATUS(status) == 0 ? CallOutcome::kFinished
                                                       : CallOutcome::kBroken;
}

}  // namespace lightsketch
