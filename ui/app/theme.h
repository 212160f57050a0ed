// Light and dark.
#pragma once

#include <QString>

namespace lightsketch {

// "dark" or "light", for the whole application. Dark is neutral grey: colours of pictures are
// judged beside it.
void applyTheme(const QString& name);

}  // namespace lightsketch
