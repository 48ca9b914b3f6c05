// What rorg says no with, and how ready each service is.
#pragma once

#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "json.hpp"

namespace rorg {

// How ready one service is: of which run that is said, or why it is not.
struct Ready {
  bool ready = false;
  std::string incarnation, reason;
};
using Readiness = std::map<std::string, Ready>;

// rorg said no, or did not answer. what() reads "cannot X: cause; try remedy", or without "try" for a remedy
// "to do" something.
class Error : public std::runtime_error {
 public:
  Error(const std::string& title, const std::string& cause, const std::string& remedy = "", int status = 0)
      : std::runtime_error(title + ": " + cause + advice(remedy)), cause(cause), remedy(remedy), status(status) {}
  std::string cause, remedy;
  int status;  // HTTP status; 0 when nobody answered

 private:
  static std::string advice(const std::string& remedy) {
    if (remedy.empty()) return "";
    return remedy.rfind("to ", 0) == 0 ? "; " + remedy.substr(3) : "; try " + remedy;
  }
};
struct Unreachable : Error { using Error::Error; };  // nobody answers
struct Untrusted : Error { using Error::Error; };    // over TLS: a certificate that is not trusted
struct Forbidden : Error { using Error::Error; };    // this caller may not
struct NotFound : Error { using Error::Error; };     // there is nothing of that name
struct Refused : Error { using Error::Error; };      // it conflicts with what is, or does not fit
struct Invalid : Error { using Error::Error; };      // the call is wrong in itself
struct NotReady : Error {                            // not ready in time; the cause says what is missing
  using Error::Error;
  Readiness services;  // of each, where rorg says so
};

namespace detail {

// Nobody answered, or not to the end.
struct Lost : Unreachable {
  Lost(const std::string& cause, bool sent, bool late = false)
      : Unreachable("cannot reach rorg", cause, "`rorg run`, or RORG_SOCKET"), sent(sent), late(late) {}
  bool sent;  // the call may have arrived
  bool late;  // time ran out
};

// What answers is no rorg, or not in its senses.
inline Error garbled(const std::string& why) { return Error("cannot read rorg's answer", why); }

inline json::Value parsed(const std::string& text) {
  try {
    return text.empty() ? json::Value() : json::parse(text);
  } catch (const json::Error& error) {
    throw garbled(error.what());
  }
}

inline Readiness readiness(const json::Value& told) {
  Readiness found;
  for (const auto& [name, one] : told["services"].fields)
    found[name] = {bool(one["ready"]), one["incarnation"].text(), one["reason"].text()};
  return found;
}

[[noreturn]] inline void raise(int status, const std::string& text) {
  json::Value told;
  try {
    told = json::parse(text);
  } catch (const json::Error&) {
  }
  // Without a title it is no answer of rorg's own, and its text is all that there is to tell.
  const bool own = !told["title"].text().empty();
  const std::string title = own ? told["title"].text() : "HTTP " + std::to_string(status);
  const std::string cause = own ? told["cause"].text() : text.substr(0, 200);
  const std::string &code = told["code"].text(), &remedy = told["remedy"].text();
  if (code == "forbidden") throw Forbidden(title, cause, remedy, status);
  if (code == "not-found") throw NotFound(title, cause, remedy, status);
  if (code == "refused") throw Refused(title, cause, remedy, status);
  if (code == "invalid") throw Invalid(title, cause, remedy, status);
  if (code == "not-ready") {
    NotReady error(title, cause, remedy, status);
    error.services = readiness(told);
    throw error;
  }
  if (status == 503 || status == 429) throw Unreachable(title, cause, remedy, status);
  throw Error(title, cause, remedy, status);
}

}  // namespace detail
}  // namespace rorg
