// What becomes of the services that requests of this program hold, from rorg's stream of events: one thread and one
// connection for each client that holds a request.
#pragma once

#include <sys/eventfd.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "session.hpp"

namespace rorg {

// Something that a request holds went away, or the request itself did.
struct Loss {
  std::string kind;     // crashed, ceased, held, shed; dropped: the request itself was, and has been made again
  std::string service;  // empty when it is the request
  std::string reason;   // for people
  std::uint64_t seq;    // number of the event; 0 where it was seen otherwise
};

namespace detail {

// The part of a request that is told of losses.
class Listener {
 public:
  Listener(std::string id, std::vector<std::string> services) : id_(std::move(id)), services_(std::move(services)) {}

  void hear(const std::function<void(const Loss&)>& callback) {
    std::lock_guard<std::recursive_mutex> guard(calling_);
    callback_ = callback;
  }
  // The callback runs under a lock, so that once hear({}) has returned it does not run any more; it may call that.
  void tell(const Loss& loss) {
    {
      std::lock_guard<std::mutex> guard(mutex_);
      loss_ = loss;
    }
    std::lock_guard<std::recursive_mutex> guard(calling_);
    try {
      if (const auto callback = callback_) callback(loss);
    } catch (...) {
      // Of no interest to rorg.
    }
  }
  std::optional<Loss> loss() const {
    std::lock_guard<std::mutex> guard(mutex_);
    return loss_;
  }
  void mended() {
    std::lock_guard<std::mutex> guard(mutex_);
    loss_.reset();
  }
  // What an event means for it. `groups` are names that stand for several.
  std::optional<Loss> loss_of(const json::Value& event, const json::Value& groups) const {
    const std::string &kind = event["kind"].text(), &service = event["service"].text(), &verb = event["verb"].text();
    const auto seq = static_cast<std::uint64_t>(std::clamp(event["seq"].number, 0.0, 9e15));
    const auto names = members(groups);
    const auto found = [&](const char* what, const std::string& whom) {
      const std::string& reason = event["reason"].text();
      return Loss{what, whom, reason.empty() ? event["message"].text() : reason, seq};
    };
    if (kind == "request-dropped" && is_own(event)) return found("dropped", "");
    if (kind == "crashed" && names.count(service) != 0) return found("crashed", service);
    if (kind == "done" && names.count(service) != 0 && (verb == "pause" || verb == "stop" || verb == "remove"))
      return found("ceased", service);
    if (kind == "holds")
      for (const auto& one : event["services"].items)
        if (names.count(one.text()) != 0) return found("held", one.text());
    if (kind == "pressure")
      for (const auto& [name, why] : event["shed"].fields)
        if (names.count(name) != 0) return Loss{"shed", name, why.text(), seq};
    return std::nullopt;
  }

 private:
  std::set<std::string> members(const json::Value& groups) const {
    std::set<std::string> found(services_.begin(), services_.end());
    for (const auto& group : groups.items)
      if (found.count(group["name"].text()) != 0)
        for (const auto& one : group["services"].items) found.insert(one.text());
    return found;
  }
  bool is_own(const json::Value& event) const {
    if (!event["id"].is_null()) return event["id"].text() == id_;
    const auto& named = event["services"].items;
    return std::equal(named.begin(), named.end(), services_.begin(), services_.end(),
                      [](const json::Value& one, const std::string& service) { return one.text() == service; });
  }
  const std::string id_;
  const std::vector<std::string> services_;
  mutable std::mutex mutex_;
  std::optional<Loss> loss_;
  std::recursive_mutex calling_;
  std::function<void(const Loss&)> callback_;
};

// Follows the events until it is destroyed, which may happen in a callback on its own thread.
class Watcher {
 public:
  explicit Watcher(std::shared_ptr<Session> session) : state_(std::make_shared<State>(std::move(session))) {
    thread_ = std::thread([state = state_] { state->run(); });
  }
  ~Watcher() {
    const std::uint64_t one = 1;
    if (::write(state_->wake, &one, sizeof(one)) < 0) state_->over = true;
    if (thread_.get_id() == std::this_thread::get_id()) thread_.detach();
    else thread_.join();
  }
  Watcher(const Watcher&) = delete;
  Watcher& operator=(const Watcher&) = delete;

  void add(const std::shared_ptr<Listener>& listener) {
    std::lock_guard<std::mutex> guard(state_->mutex);
    auto& all = state_->listeners;
    all.erase(std::remove_if(all.begin(), all.end(), [](const auto& one) { return one.expired(); }), all.end());
    all.push_back(listener);
  }

 private:
  struct State {
    explicit State(std::shared_ptr<Session> session) : session(std::move(session)) {}
    ~State() {
      if (wake >= 0) ::close(wake);
    }
    void run() {
      for (Seconds pause(0.1); !over; pause = std::min(pause * 2, Seconds(1))) {
        try {
          follow(pause);
        } catch (const Stopped&) {
          return;
        } catch (const Unreachable&) {
          // rorg may be restarting; the cursor knows what was missed.
        } catch (const Error& error) {
          if (error.status >= 400) return;  // this caller may not, or this rorg cannot
        } catch (const std::exception&) {
        }
        pollfd found{wake, POLLIN, 0};
        if (::poll(&found, 1, static_cast<int>(pause.count() * 1000)) > 0) return;
      }
    }
    void follow(Seconds& pause) {
      const auto connection = session->connect(in(session->timeout));
      connection->stop_at(wake);
      const auto head = connection->begin(
          "GET", "/v1/events?mine=true&follow=true" + (cursor ? "&cursor=" + std::to_string(*cursor) : ""), "", "",
          in(session->timeout));
      std::string text;
      if (head.status >= 300) {
        while (connection->part(text, in(session->timeout))) {
        }
        raise(head.status, text);
      }
      // From here on it is known what was missed, though nothing has been seen yet.
      if (!cursor) cursor = whole(head.header("rorg-cursor"));
      pause = Seconds(0.1);
      while (connection->part(text, Time::max())) {
        for (std::size_t end; (end = text.find('\n')) != std::string::npos; text.erase(0, end + 1))
          tell(text.substr(0, end));
        if (text.size() > longest) throw garbled("a line is too long");
      }
    }
    void tell(const std::string& line) {
      json::Value event;
      try {
        event = json::parse(line);
      } catch (const json::Error&) {
        return;
      }
      const double seq = event["seq"].number;
      if (seq >= 1 && seq < 9e15) cursor = static_cast<std::uint64_t>(seq);
      std::vector<std::shared_ptr<Listener>> all;
      {
        std::lock_guard<std::mutex> guard(mutex);
        for (const auto& one : listeners)
          if (auto found = one.lock()) all.push_back(std::move(found));
      }
      const auto& kind = event["kind"].text();
      if (!groups || kind == "tree-accepted") groups = known_groups();
      for (const auto& one : all)
        if (const auto loss = one->loss_of(event, *groups)) one->tell(*loss);
    }
    json::Value known_groups() const {
      try {
        const auto answer = session->call(
            {"GET", "/v1/groups", "", std::min(session->timeout, Seconds(2)), Seconds(0), true});
        return answer.status < 300 ? parsed(answer.body) : json::Value();
      } catch (const Error&) {
        return {};
      }
    }
    static constexpr std::size_t longest = 1 << 20;
    const std::shared_ptr<Session> session;
    const int wake = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    std::atomic<bool> over{false};
    std::mutex mutex;
    std::vector<std::weak_ptr<Listener>> listeners;
    std::optional<std::uint64_t> cursor;
    std::optional<json::Value> groups;
  };
  std::shared_ptr<State> state_;
  std::thread thread_;
};

}  // namespace detail
}  // namespace rorg
