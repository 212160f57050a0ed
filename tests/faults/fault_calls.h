// Stands between a program and the system calls by which it changes files (open for writing, write,
// fsync, rename, ftruncate, unlink, mkdir; of regular files and folders only), counts them, and at
// a given one kills the program or lets it fail. A shared library: linked into a test it is armed
// by a call, preloaded into a program by LIGHTSKETCH_FAULT="CALL ACTION [COUNTFILE]".
#pragma once

// The process dies by SIGKILL; a write() gets half of its bytes to the file first.
#define FAULT_KILL 0
// Above: the errno with which the call and all later ones fail; below: that call alone.

extern "C" {
// Counts from 1; nothing happens at call 0. Forgets earlier calls.
void faultArm(int call, int action);
void faultDisarm();
// Calls since the last faultArm().
int faultCalls();
// Every write and fsync takes so long from now on: a slow disk.
void faultDelay(int microseconds);
// The machine's clock (not the monotonic one) is off by so much from now on.
void faultClock(int seconds);
}
