// Names, ids and seconds as the API reads them.
#pragma once

#include <algorithm>
#include <cctype>
#include <chrono>
#include <iomanip>
#include <locale>
#include <sstream>
#include <string>

#include "errors.hpp"

namespace rorg {

using Seconds = std::chrono::duration<double>;

namespace detail {

using Time = std::chrono::steady_clock::time_point;

// A point of time so far from now; far away for what no clock can hold.
inline Time in(Seconds seconds) {
  const double count = seconds.count() > 0 ? std::min(seconds.count(), 1e8) : 0;
  return std::chrono::steady_clock::now() + std::chrono::duration_cast<Time::duration>(Seconds(count));
}
inline Seconds left(Time deadline) {
  return std::max(Seconds(0), Seconds(deadline - std::chrono::steady_clock::now()));
}

inline std::string escaped(const std::string& text) {
  static const char* digits = "0123456789ABCDEF";
  std::string found;
  for (const char one : text) {
    const auto c = static_cast<unsigned char>(one);
    if (std::isalnum(c) || c == '-' || c == '_' || c == '.' || c == '~') {
      found += static_cast<char>(c);
    } else {
      found += '%';
      found += digits[c >> 4];
      found += digits[c & 15];
    }
  }
  return found;
}

// Seconds as the API reads them, whatever the program's locale.
inline std::string written(Seconds seconds) {
  std::ostringstream stream;
  stream.imbue(std::locale::classic());
  stream << std::fixed << std::setprecision(6) << seconds.count();
  return stream.str();
}

inline bool is_plain(unsigned char c, const char* also) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
         (c != 0 && std::string(also).find(static_cast<char>(c)) != std::string::npos);
}

// Told here, since in an address such a text would mean something else.
inline const std::string& checked_id(const std::string& id) {
  const bool good = !id.empty() && id.size() <= 64 && is_plain(static_cast<unsigned char>(id[0]), "") &&
                    std::all_of(id.begin(), id.end(), [](unsigned char c) { return is_plain(c, "_.:-"); });
  if (!good)
    throw Invalid("cannot request as '" + id + "'", "invalid id: it begins with a letter or digit, and has at most 64 "
                  "of letters, digits and _ . : -", "another id", 422);
  return id;
}
inline const std::string& checked_name(const std::string& name) {
  const bool good = !name.empty() && name.size() <= 64 && is_plain(static_cast<unsigned char>(name[0]), "") &&
                    std::all_of(name.begin(), name.end(), [](unsigned char c) { return is_plain(c, "_.-"); });
  if (!good)
    throw Invalid("cannot use the name '" + name + "'", "invalid name: it begins with a letter or digit, and has at "
                  "most 64 of letters, digits and _ . -", "a name of `rorg get services`", 422);
  return name;
}

}  // namespace detail
}  // namespace rorg
