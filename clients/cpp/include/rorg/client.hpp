// The calls of rorg's API.
#pragma once

#include <atomic>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "request.hpp"

namespace rorg {

// A manifest of the tree. The digest is that of its text, and says which version a change was made of.
struct Manifest {
  std::string kind, name, text, digest;
};

// Copies are the same client. It may be used from several threads at once.
class Client {
 public:
  // `timeout`: seconds for one answer. `patience`: seconds for which a call is repeated while nobody answers.
  explicit Client(Where where, Seconds timeout = Seconds(10), Seconds patience = Seconds(30))
      : session_(std::make_shared<detail::Session>(std::move(where), timeout, patience)) {}
  explicit Client(const std::string& address = detail::default_address(), Seconds timeout = Seconds(10),
                  Seconds patience = Seconds(30))
      : Client(at(address), timeout, patience) {}

  // Requests services and keeps the request until the returned object is destroyed, or release() is called. `id`: the
  // same one again replaces the request. `ttl`: its lease, renewed three times as often; when this program dies, the
  // request ends with its container, or when the lease runs out.
  Request request(const std::vector<std::string>& services, std::string id = "", Seconds ttl = Seconds(10),
                  const std::string& reason = "", std::optional<int> priority = std::nullopt);
  // A future of a request whose services are ready. Who drops the future drops the request.
  std::future<Request> request_async(const std::vector<std::string>& services, Seconds wait = Seconds(30),
                                     const std::string& id = "", Seconds ttl = Seconds(10),
                                     const std::string& reason = "", std::optional<int> priority = std::nullopt) {
    return detail::in_background([=, client = *this]() mutable {
      auto made = client.request(services, id, ttl, reason, priority);
      made.wait(wait);
      return made;
    });
  }

  // Returns when the services and all that they need are ready, as this program's last change left them; throws
  // NotReady with what is missing.
  Readiness wait(const std::vector<std::string>& services, Seconds timeout) {
    return detail::wait(*session_, checked(services), timeout);
  }
  std::future<Readiness> wait_async(const std::vector<std::string>& services, Seconds timeout) {
    return detail::in_background([session = session_, names = checked(services), timeout] {
      return detail::wait(*session, names, timeout);
    });
  }
  // How ready each of them is now, or why it is not.
  Readiness readiness(const std::vector<std::string>& services) {
    try {
      return wait(services, Seconds(0));
    } catch (const NotReady& error) {
      if (!error.services.empty()) return error.services;
      if (services.size() == 1) return {{services.front(), {false, "", error.cause}}};
    }
    // An rorg that only tells of the first: each is asked for by itself.
    Readiness found;
    for (const auto& service : services) found.merge(readiness({service}));
    return found;
  }

  // How a service is: fields state, health, wanted, why, held and more.
  json::Value service(const std::string& name) { return call("GET", of("services", name)); }
  json::Value services() { return call("GET", "/v1/services"); }
  json::Value requests() { return call("GET", "/v1/requests"); }
  json::Value why(const std::string& name) { return call("GET", of("services", name) + "/why"); }
  void release(const std::string& id) { call("DELETE", "/v1/requests/" + detail::escaped(detail::checked_id(id))); }
  // Stops and starts a service, or each of a group; drivers only with `force`. With `wait`, returns when the new run
  // is ready.
  void restart(const std::string& name, bool force = false, std::optional<Seconds> wait = std::nullopt) {
    call("POST", of("services", name) + "/restart" + (force ? "?force=true" : ""));
    if (wait) this->wait({name}, *wait);
  }

  json::Value manifests() { return call("GET", "/v1/manifests"); }
  Manifest manifest(const std::string& kind, const std::string& name) {
    const auto answer = ask("GET", of("manifests", kind, name));
    std::string digest = answer.header("etag");
    if (digest.size() >= 2 && digest.front() == '"') digest = digest.substr(1, digest.size() - 2);
    return {kind, name, answer.body, digest};
  }
  // Writes a manifest and returns its digest. `base`: the digest of the version that was edited, empty for a new one;
  // Refused when it is not the present one.
  std::string put_manifest(const std::string& kind, const std::string& name, const std::string& text,
                           const std::string& base = "", const std::string& message = "");
  void remove_manifest(const std::string& kind, const std::string& name, const std::string& base,
                       const std::string& message = "");

  // One call of the API: JSON back, or an Error. It is repeated while nobody answers; one that must not happen twice
  // only where it surely did not arrive.
  json::Value call(const std::string& method, const std::string& path, const std::string& body = "",
                   std::optional<Seconds> timeout = std::nullopt, std::optional<Seconds> patience = std::nullopt) {
    return detail::parsed(ask(method, path, body, timeout, patience).body);
  }

  const std::string& address() const { return session_->where.address; }

 private:
  static Where at(const std::string& address) {
    Where where;
    where.address = address;
    return where;
  }
  template <typename... More>
  static std::string of(const std::string& what, const More&... names) {
    return "/v1/" + what + (... + ("/" + detail::checked_name(names)));
  }
  static const std::vector<std::string>& checked(const std::vector<std::string>& services) {
    if (services.empty()) throw Invalid("cannot request", "no service is named", "one at least");
    for (const auto& service : services) detail::checked_name(service);
    return services;
  }
  detail::Answer ask(const std::string& method, const std::string& path, const std::string& body = "",
                     std::optional<Seconds> timeout = std::nullopt, std::optional<Seconds> patience = std::nullopt) {
    const bool renew = path.size() > 6 && path.compare(path.size() - 6, 6, "/renew") == 0;
    const bool manifest = method != "GET" && path.compare(0, 14, "/v1/manifests/") == 0;
    auto answer = session_->call({method, path, body, timeout.value_or(session_->timeout),
                                  patience.value_or(session_->patience), (method != "POST" && !manifest) || renew,
                                  method == "GET" ? session_->changed() : method == "DELETE" ? 0 : session_->declared()});
    if (answer.status >= 300) detail::raise(answer.status, answer.body);
    return answer;
  }
  std::shared_ptr<detail::Session> session_;
};

inline Request Client::request(const std::vector<std::string>& services, std::string id, Seconds ttl,
                               const std::string& reason, std::optional<int> priority) {
  static std::atomic<unsigned> number{0};
  checked(services);
  if (id.empty())
    id = services.front().substr(0, 40) + "-" + std::to_string(::getpid()) + "-" + std::to_string(++number);
  detail::checked_id(id);
  auto state = std::make_shared<Request::State>();
  state->session = session_;
  state->id = std::move(id);
  state->services = services;
  state->ttl = ttl;
  std::string body = "{\"services\":[";
  for (std::size_t i = 0; i < services.size(); ++i) body += (i ? "," : "") + json::quoted(services[i]);
  body += "],\"reason\":" + json::quoted(reason) + ",\"ttl\":\"" + detail::written(ttl) + "s\"";
  if (priority) body += ",\"priority\":" + std::to_string(*priority);
  state->body = body + "}";
  state->listener = std::make_shared<detail::Listener>(state->id);
  state->watcher = session_->watcher([&] { return std::make_shared<detail::Watcher>(session_); });
  state->watcher->add(state->listener);
  state->tell("PUT", "", session_->timeout, session_->patience);
  Request made(state);
  // The thread has no share in the request, whose destructor waits for it.
  state->beat = std::thread([running = state.get()] { running->run(); });
  return made;
}

inline std::string Client::put_manifest(const std::string& kind, const std::string& name, const std::string& text,
                                        const std::string& base, const std::string& message) {
  const std::string body = "{\"text\":" + json::quoted(text) + ",\"base\":" + (base.empty() ? "null" : json::quoted(base)) +
                           ",\"message\":" + json::quoted(message) + "}";
  try {
    return call("PUT", of("manifests", kind, name), body)["digest"].text();
  } catch (const detail::Lost&) {
    // It may have arrived: what is there now tells.
    const auto now = manifest(kind, name);
    if (now.text == text) return now.digest;
    throw;
  }
}

inline void Client::remove_manifest(const std::string& kind, const std::string& name, const std::string& base,
                                    const std::string& message) {
  const std::string query = "?base=" + detail::escaped(base) + "&message=" + detail::escaped(message);
  try {
    call("DELETE", of("manifests", kind, name) + query);
  } catch (const detail::Lost&) {
    try {
      manifest(kind, name);
    } catch (const NotFound&) {
      return;
    }
    throw;
  }
}

}  // namespace rorg
