// For the reports.
#pragma once

#include <string>
#include <string_view>

namespace lightsketch {

// Text as the content of an HTML element or a quoted attribute.
std::string htmlEscaped(std::string_view text);

}  // namespace lightsketch
