// What becomes of the services that requests of this program hold, from rorg's stream of events: one thread and one
// connection for each client that holds a request.
#pragma once

#include <sys/eventfd.h>

#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "session.hpp"

namespace rorg {

// A service of a request that was ready, and is so no more; or the request itself went.
struct Loss {
  std::string service;      // empty when it is the request
  std::string cause;        // crashed, hung, unready, restarted, replaced, held, shed, preempted, ceased; dropped: the
                            // request was, and is made again
  std::string reason;       // for people
  std::string incarnation;  // the run that was ready
};

namespace detail {

// The part of a request that is told of losses.
class Listener {
 public:
  explicit Listener(std::string id) : id_(std::move(id)) {}

  void hear(const std::function<void(const Loss&)>& callback) {
    std::lock_guard<std::recursive_mutex> guard(calling_);
    callback_ = callback;
  }
  // The callback runs under a lock, so that once hear({}) has returned it does not run any more; it may call that.
  void tell(const Loss& loss) {
    {
      std::lock_guard<std::mutex> guard(mutex_);
      // Both the events and the heartbeat may see that the request went.
      if (loss.cause == "dropped" && loss_ && loss_->cause == "dropped") return;
      // So do the events and a look at the service.
      if (!loss.incarnation.empty() && std::exchange(lost_[loss.service], loss.incarnation) == loss.incarnation) return;
      loss_ = loss;
      runs_.erase(loss.service);
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
  // All is ready, in these runs.
  void mended(const Readiness& services) {
    std::lock_guard<std::mutex> guard(mutex_);
    loss_.reset();
    lost_.clear();
    runs_.clear();
    for (const auto& [name, one] : services)
      if (!one.incarnation.empty()) runs_[name] = one.incarnation;
  }
  std::map<std::string, std::string> runs() const {
    std::lock_guard<std::mutex> guard(mutex_);
    return runs_;
  }
  // What an event means for it.
  std::optional<Loss> loss_of(const json::Value& event) const {
    const std::string &kind = event["kind"].text(), &service = event["service"].text(),
                      &run = event["incarnation"].text();
    if (kind == "request-dropped" && event["request"].text() == id_)
      return Loss{"", "dropped", event["message"].text(), ""};
    const auto& ids = event["requests"].items;
    if (kind != "lost" || std::none_of(ids.begin(), ids.end(), [&](const auto& id) { return id.text() == id_; }))
      return std::nullopt;
    const auto known = runs();
    const auto found = known.find(service);
    if (found != known.end() && found->second != run) return std::nullopt;  // of a run before the one that is ready
    return Loss{service, event["cause"].text(), event["message"].text(), run};
  }

 private:
  const std::string id_;
  mutable std::mutex mutex_;
  std::optional<Loss> loss_;
  std::map<std::string, std::string> runs_;  // of each service, the one that it was told is ready
  std::map<std::string, std::string> lost_;  // and the one that it was told is lost
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
          if (error.status >= 400) pause = Seconds(5);  // it may not, or that rorg cannot: the next one, perhaps
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
      look();
      while (connection->part(text, Time::max())) {
        for (std::size_t end; (end = text.find('\n')) != std::string::npos; text.erase(0, end + 1))
          tell(text.substr(0, end));
        if (text.size() > longest) throw garbled("a line is too long");
      }
    }
    void tell(const std::string& line) {
      const auto event = read(line);
      const double seq = event["seq"].number;
      if (seq >= 1 && seq < 9e15) cursor = static_cast<std::uint64_t>(seq);
      for (const auto& one : all())
        if (const auto loss = one->loss_of(event)) one->tell(*loss);
    }
    static json::Value read(const std::string& line) {
      try {
        return json::parse(line);
      } catch (const json::Error&) {
        return {};
      }
    }
    Answer ask(const std::string& path) {
      return session->call({"GET", path, "", std::min(session->timeout, Seconds(2)), Seconds(0), true});
    }
    // What the journal says of the loss of a service in the run that a request was told is ready.
    std::optional<Loss> told(const Listener& request, const std::string& name) {
      const auto answer = ask("/v1/events?mine=true&tail=20&kind=lost&service=" + escaped(name));
      std::istringstream lines(answer.status < 300 ? answer.body : "");
      for (std::string line; std::getline(lines, line);)
        if (auto loss = request.loss_of(read(line))) return loss;
      return std::nullopt;
    }
    // What was lost while nobody told: another run, or none, is there now.
    void look() {
      for (const auto& one : all()) {
        for (const auto& [name, run] : one->runs()) {
          const auto answer = ask("/v1/services/" + escaped(name));
          if (answer.status >= 300) continue;
          const auto now = parsed(answer.body);
          const auto &state = now["state"].text(), &incarnation = now["incarnation"].text();
          if (state.empty() || (state == "running" && incarnation == run)) continue;
          const bool other = !incarnation.empty() && incarnation != run;
          const bool crashed = state == "exited" && now["wanted"].flag;
          const char* cause =
              other ? "restarted" : !now["held"].text().empty() ? "held" : crashed ? "crashed" : "ceased";
          const Loss seen{name, cause, name + " is " + state + (other ? ", in another run than before" : ""), run};
          one->tell(told(*one, name).value_or(seen));
        }
      }
    }
    std::vector<std::shared_ptr<Listener>> all() {
      std::vector<std::shared_ptr<Listener>> found;
      std::lock_guard<std::mutex> guard(mutex);
      for (const auto& one : listeners)
        if (auto listener = one.lock()) found.push_back(std::move(listener));
      return found;
    }
    static constexpr std::size_t longest = 1 << 20;
    const std::shared_ptr<Session> session;
    const int wake = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    std::atomic<bool> over{false};
    std::mutex mutex;
    std::vector<std::weak_ptr<Listener>> listeners;
    std::optional<std::uint64_t> cursor;
  };
  std::shared_ptr<State> state_;
  std::thread thread_;
};

}  // namespace detail
}  // namespace rorg
