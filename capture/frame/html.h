// For the reports.
#pragma once

#include <string>
#include <string_view>

namespace lightsketch {

// Text as the content of an HTML element or a quoted attribute.
std::string htmlEscaped(std::string_view text);

// For pictures inside a page: "data:image/png;base64,..." (RFC 4648).
std::string base64(std::string_view bytes);

}  // namespace lightsketch
