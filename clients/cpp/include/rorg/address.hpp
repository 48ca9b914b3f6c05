// Where rorg is, and how to know it there.
#pragma once

#include <cstdlib>
#include <string>
#include <utility>

#include "errors.hpp"

namespace rorg {

namespace detail {

inline std::string environment(const char* name) {
  const char* found = std::getenv(name);
  return found ? found : "";
}

inline std::string default_address() {
  if (const auto given = environment("RORG_SOCKET"); !given.empty()) return given;
  if (const auto given = environment("RORG_ADDRESS"); !given.empty()) return given;
  if (const auto folder = environment("RORG_RUN_DIR"); !folder.empty()) return folder + "/rorg.sock";
  if (const auto state = environment("RORG_STATE_DIR"); !state.empty()) return state + "/run/rorg.sock";
  return "/run/rorg/rorg.sock";
}

}  // namespace detail

// `address` is the path of a socket, also as unix:///path, or https://host:port. For https: PEM files of the authority
// that signed rorg's certificate (empty: those that this machine trusts), and of this program's certificate and key.
struct Where {
  std::string address = detail::default_address();
  std::string ca = detail::environment("RORG_CA");
  std::string cert = detail::environment("RORG_CERT");
  std::string key = detail::environment("RORG_KEY");
};

namespace detail {

// A Where, taken apart. Raises Invalid for what is no address.
struct Place {
  std::string path;        // of the socket; empty over TLS
  std::string host, port;  // over TLS
  explicit Place(const std::string& address) {
    const std::string unix_scheme = "unix://", https = "https://";
    if (address.compare(0, https.size(), https) == 0) {
      std::string rest = address.substr(https.size());
      if (!rest.empty() && rest.back() == '/') rest.pop_back();
      const auto colon = rest.rfind(':');
      if (colon == std::string::npos || colon == 0 || colon + 1 == rest.size() ||
          rest.find_first_not_of("0123456789", colon + 1) != std::string::npos)
        wrong(address);
      host = rest.substr(0, colon);
      port = rest.substr(colon + 1);
      if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    } else if (address.compare(0, unix_scheme.size(), unix_scheme) == 0) {
      path = address.substr(unix_scheme.size());
    } else {
      path = address;
    }
    if (host.empty() && (path.empty() || path.find("://") != std::string::npos)) wrong(address);
  }

 private:
  [[noreturn]] static void wrong(const std::string& address) {
    throw Invalid("cannot reach rorg on '" + address + "'", "that is no address", "/path, unix:///path or "
                  "https://host:port");
  }
};

}  // namespace detail
}  // namespace rorg
