// rorg from C++17: request services, wait until they are ready, release them. Header-only; the standard library and
// POSIX sockets are all it needs.
//
//   rorg::Client client;                                   // RORG_SOCKET, or /run/rorg/rorg.sock
//   auto navigation = client.request({"navigation"});      // kept by a heartbeat, released by its destructor
//   client.wait({"navigation"}, std::chrono::seconds(30)); // throws rorg::NotReady with what is missing
//
// A client may be used from several threads; its calls go one after the other. Every call may be repeated without harm,
// and is, while nobody answers: a restart of rorg goes unnoticed.
#pragma once

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <iomanip>
#include <locale>
#include <memory>
#include <mutex>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "json.hpp"

namespace rorg {

using Seconds = std::chrono::duration<double>;

// rorg said no, or did not answer. what() reads "cannot X: cause; try remedy".
class Error : public std::runtime_error {
 public:
  Error(const std::string& title, const std::string& cause, const std::string& remedy = "", int status = 0)
      : std::runtime_error(title + ": " + cause + (remedy.empty() ? "" : "; try " + remedy)),
        cause(cause), remedy(remedy), status(status) {}
  std::string cause, remedy;
  int status;  // HTTP status; 0 when nobody answered
};
struct Unreachable : Error { using Error::Error; };  // nobody answers on the socket
struct Forbidden : Error { using Error::Error; };    // this caller may not
struct NotFound : Error { using Error::Error; };     // there is nothing of that name
struct Refused : Error { using Error::Error; };      // it conflicts with what is, or does not fit
struct Invalid : Error { using Error::Error; };      // the call is wrong in itself
struct NotReady : Error { using Error::Error; };     // not ready in time; the cause says what is missing

namespace detail {

inline std::string default_socket() {
  if (const char* given = std::getenv("RORG_SOCKET")) return given;
  if (const char* folder = std::getenv("RORG_RUN_DIR")) return std::string(folder) + "/rorg.sock";
  if (const char* state = std::getenv("RORG_STATE_DIR")) return std::string(state) + "/run/rorg.sock";
  return "/run/rorg/rorg.sock";
}

inline std::string escaped(const std::string& text) {
  static const char* digits = "0123456789ABCDEF";
  std::string found;
  for (unsigned char c : text) {
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

// One connection; nothing is shared, nothing is retried.
class Connection {
 public:
  Connection(const std::string& path, Seconds timeout) {
    const auto slash = path.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash);
    // A path may be longer than the 107 bytes of a socket address; an open directory stands for its folder.
    const int directory = ::open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (directory < 0) fail("no directory " + folder);
    const std::string address = "/proc/self/fd/" + std::to_string(directory) + "/" + path.substr(slash + 1);
    socket_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    set_timeout(timeout);
    sockaddr_un name{};
    name.sun_family = AF_UNIX;
    std::strncpy(name.sun_path, address.c_str(), sizeof(name.sun_path) - 1);
    const int result = ::connect(socket_, reinterpret_cast<sockaddr*>(&name), sizeof(name));
    const int error = errno;
    ::close(directory);
    if (result != 0) {
      ::close(socket_);
      socket_ = -1;
      errno = error;
      fail(path);
    }
  }
  ~Connection() {
    if (socket_ >= 0) ::close(socket_);
  }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  void set_timeout(Seconds timeout) {
    timeval value{};
    value.tv_sec = static_cast<time_t>(timeout.count());
    value.tv_usec = static_cast<suseconds_t>((timeout.count() - static_cast<double>(value.tv_sec)) * 1e6);
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &value, sizeof(value));
    ::setsockopt(socket_, SOL_SOCKET, SO_SNDTIMEO, &value, sizeof(value));
  }

  std::pair<int, std::string> call(const std::string& method, const std::string& path, const std::string& body) {
    std::string text = method + " " + path + " HTTP/1.1\r\nhost: rorg\r\n";
    if (!body.empty()) text += "content-type: application/json\r\n";
    text += "content-length: " + std::to_string(body.size()) + "\r\n\r\n" + body;
    for (std::size_t sent = 0; sent < text.size();) {
      const auto count = ::send(socket_, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
      if (count <= 0) fail("send");
      sent += static_cast<std::size_t>(count);
    }
    std::size_t head;
    while ((head = buffer_.find("\r\n\r\n")) == std::string::npos) receive();
    const int status = buffer_.size() > 12 ? std::atoi(buffer_.c_str() + 9) : 0;
    const std::string headers = buffer_.substr(0, head + 2);
    buffer_.erase(0, head + 4);
    if (header(headers, "transfer-encoding:").find("chunked") != std::string::npos) return {status, chunks()};
    return {status, take(std::strtoul(header(headers, "content-length:").c_str(), nullptr, 10))};
  }

 private:
  [[noreturn]] static void fail(const std::string& what) {
    throw Unreachable("cannot reach rorg", what + ": " + std::strerror(errno), "`rorg run`, or RORG_SOCKET");
  }
  void receive() {
    char chunk[16384];
    const auto count = ::recv(socket_, chunk, sizeof(chunk), 0);
    if (count == 0) errno = ECONNRESET;
    if (count <= 0) fail("receive");
    buffer_.append(chunk, static_cast<std::size_t>(count));
  }
  std::string take(std::size_t length) {
    while (buffer_.size() < length) receive();
    std::string found = buffer_.substr(0, length);
    buffer_.erase(0, length);
    return found;
  }
  std::string line() {
    std::size_t end;
    while ((end = buffer_.find("\r\n")) == std::string::npos) receive();
    std::string found = take(end);
    take(2);
    return found;
  }
  std::string chunks() {
    std::string found;
    while (const std::size_t length = std::strtoul(line().c_str(), nullptr, 16)) {
      found += take(length);
      take(2);
    }
    while (!line().empty()) {
    }
    return found;
  }
  // The value of a header, empty when it is not there. `name` is in small letters, with its colon.
  static std::string header(const std::string& head, const std::string& name) {
    for (std::size_t at = head.find("\r\n"); at != std::string::npos; at = head.find("\r\n", at + 2)) {
      std::size_t i = 0;
      while (i < name.size() && at + 2 + i < head.size() &&
             std::tolower(static_cast<unsigned char>(head[at + 2 + i])) == name[i]) ++i;
      if (i == name.size()) return head.substr(at + 2 + i, head.find("\r\n", at + 2) - at - 2 - i);
    }
    return "";
  }
  int socket_ = -1;
  std::string buffer_;
};

}  // namespace detail

class Request;

class Client {
 public:
  explicit Client(std::string socket = detail::default_socket(), Seconds timeout = Seconds(10),
                  Seconds patience = Seconds(30))
      : socket_(std::move(socket)), timeout_(timeout), patience_(patience) {}

  // Requests services and keeps the request until the returned object is destroyed, or release() is called. `id`: the
  // same one again replaces the request. `ttl`: its lease, renewed three times as often; when this program dies, the
  // request ends with its container, or when the lease runs out.
  Request request(std::vector<std::string> services, std::string id = "", Seconds ttl = Seconds(10),
                  const std::string& reason = "", std::optional<int> priority = std::nullopt);

  // Returns when the services and all that they need are ready; throws NotReady with what is missing.
  void wait(const std::vector<std::string>& services, Seconds timeout) {
    std::string query;
    for (const auto& service : services) query += "services=" + detail::escaped(service) + "&";
    call("GET", "/v1/wait?" + query + "timeout=" + detail::written(timeout), "", timeout + timeout_, timeout);
  }

  // How a service is: fields state, health, wanted, why, held and more.
  json::Value service(const std::string& name) { return call("GET", "/v1/services/" + detail::escaped(name)); }
  json::Value services() { return call("GET", "/v1/services"); }
  json::Value requests() { return call("GET", "/v1/requests"); }
  json::Value why(const std::string& name) { return call("GET", "/v1/services/" + detail::escaped(name) + "/why"); }
  void release(const std::string& id) { call("DELETE", "/v1/requests/" + detail::escaped(id)); }
  void restart(const std::string& name, bool force = false) {
    call("POST", "/v1/services/" + detail::escaped(name) + "/restart" + (force ? "?force=true" : ""));
  }

  // One call of the API: JSON back, or an Error.
  json::Value call(const std::string& method, const std::string& path, const std::string& body = "",
                   std::optional<Seconds> timeout = std::nullopt, std::optional<Seconds> patience = std::nullopt) {
    const auto end = std::chrono::steady_clock::now() + patience.value_or(patience_);
    Seconds pause(0.02);
    for (bool fresh = true;;) {
      try {
        std::lock_guard<std::mutex> guard(mutex_);
        fresh = !connection_;
        if (!connection_) connection_ = std::make_unique<detail::Connection>(socket_, timeout.value_or(timeout_));
        connection_->set_timeout(timeout.value_or(timeout_));
        try {
          const auto [status, text] = connection_->call(method, path, body);
          if (status == 503) throw Unreachable("cannot reach rorg", text);  // it has just begun, or is full
          if (status >= 400) raise(status, text);
          return text.empty() ? json::Value() : json::parse(text);
        } catch (const json::Error& error) {
          throw Error("cannot read rorg's answer", error.what());
        } catch (const Unreachable&) {
          connection_.reset();
          throw;
        }
      } catch (const Unreachable&) {
        // One that was kept may have been closed meanwhile, which says nothing of who is there now.
        if (!fresh) continue;
        if (std::chrono::steady_clock::now() + pause > end) throw;
      }
      std::this_thread::sleep_for(pause);
      pause = std::min(pause * 2, Seconds(0.5));
    }
  }

  const std::string& socket() const { return socket_; }

 private:
  [[noreturn]] static void raise(int status, const std::string& text) {
    json::Value told;
    try {
      told = json::parse(text);
    } catch (const json::Error&) {
    }
    const std::string code = told["code"].text(), title = told["title"].text(), cause = told["cause"].text(),
                      remedy = told["remedy"].text();
    if (code == "forbidden") throw Forbidden(title, cause, remedy, status);
    if (code == "not-found") throw NotFound(title, cause, remedy, status);
    if (code == "refused") throw Refused(title, cause, remedy, status);
    if (code == "invalid") throw Invalid(title, cause, remedy, status);
    if (code == "not-ready") throw NotReady(title, cause, remedy, status);
    throw Error(title.empty() ? "HTTP " + std::to_string(status) : title, cause, remedy, status);
  }

  friend class Request;
  std::string socket_;
  Seconds timeout_, patience_;
  std::mutex mutex_;
  std::unique_ptr<detail::Connection> connection_;
};

// A request that this program holds, released when it is destroyed. Movable, not copyable.
class Request {
 public:
  Request(Request&&) = default;
  Request& operator=(Request&& other) {
    if (this != &other) {
      release_quietly();
      state_ = std::move(other.state_);
    }
    return *this;
  }
  ~Request() { release_quietly(); }

  // Gives it up; may be called twice. Throws Unreachable when nobody answers for the client's patience: call it again.
  void release() {
    if (!state_) return;
    state_->stop();
    state_->client->release(state_->id);
    state_.reset();
  }
  // Lets go of it without releasing: for a request that another one with the same id has replaced.
  void abandon() {
    if (const auto state = std::move(state_)) state->stop();
  }
  std::string id() const { return state_ ? state_->id : ""; }

 private:
  friend class Client;
  struct State {
    Client* client;
    std::string id, body;
    Seconds ttl;
    std::mutex mutex;
    std::condition_variable changed;
    bool over = false;
    std::thread beat;

    void stop() {
      {
        std::lock_guard<std::mutex> guard(mutex);
        over = true;
      }
      changed.notify_all();
      if (beat.joinable()) beat.join();
    }
    void run() {
      // A connection of its own: a beat does not wait for a call of the program.
      Client own(client->socket(), std::min(ttl / 3, client->timeout_), Seconds(0));
      std::unique_lock<std::mutex> lock(mutex);
      while (!changed.wait_for(lock, ttl / 3, [this] { return over; })) {
        lock.unlock();
        try {
          try {
            own.call("POST", "/v1/requests/" + detail::escaped(id) + "/renew");
          } catch (const NotFound&) {
            own.call("PUT", "/v1/requests/" + detail::escaped(id), body);
          }
        } catch (const std::exception&) {
          // The next beat tries again: rorg may be restarting.
        }
        lock.lock();
      }
    }
  };
  explicit Request(std::unique_ptr<State> state) : state_(std::move(state)) {}
  void release_quietly() noexcept {
    try {
      release();
    } catch (...) {
      // Nobody answered; the lease ends it.
    }
  }
  std::unique_ptr<State> state_;
};

inline Request Client::request(std::vector<std::string> services, std::string id, Seconds ttl, const std::string& reason,
                               std::optional<int> priority) {
  static std::atomic<unsigned> number{0};
  if (services.empty()) throw Invalid("cannot request", "no service is named", "one at least");
  if (id.empty()) id = services.front() + "-" + std::to_string(::getpid()) + "-" + std::to_string(++number);
  std::string body = "{\"services\":[";
  for (std::size_t i = 0; i < services.size(); ++i) body += (i ? "," : "") + json::quoted(services[i]);
  body += "],\"reason\":" + json::quoted(reason) + ",\"ttl\":\"" + detail::written(ttl) + "s\"";
  if (priority) body += ",\"priority\":" + std::to_string(*priority);
  body += "}";
  call("PUT", "/v1/requests/" + detail::escaped(id), body);
  auto state = std::make_unique<Request::State>();
  state->client = this;
  state->id = std::move(id);
  state->body = std::move(body);
  state->ttl = ttl;
  auto* running = state.get();
  state->beat = std::thread([running] { running->run(); });
  return Request(std::move(state));
}

}  // namespace rorg
