// What stands on the table, from one start to the next.
#pragma once

#include <QSettings>

#include "ui/app/rig_link.h"

namespace lightsketch {

// Which cameras, their settings and calibration files. How the simulated rig behaves is not kept.
void saveRigSetup(QSettings& settings, const RigSetup& setup);
// What was never saved, or makes no sense, is RigSetup's own.
RigSetup loadRigSetup(const QSettings& settings);

}  // namespace lightsketch
