// Frames out of a sketch and back in, undoable.
#pragma once

#include <QString>
#include <filesystem>
#include <string>
#include <vector>

namespace lightsketch {

class Workspace;

// Drops them in the background and pushes what undoes it, as `text`. Nothing happens without ids.
// Edits of a sketch wait for one another; sketchEdited() tells when each is done. UI thread.
void dropFrames(Workspace& workspace, const std::filesystem::path& sketch, std::vector<int> ids,
                std::string reason, const QString& text);
// The same the other way round; `reason` is for who undoes it.
void restoreFrames(Workspace& workspace, const std::filesystem::path& sketch, std::vector<int> ids,
                   std::string reason, const QString& text);

}  // namespace lightsketch
