// A request that this program holds: kept by a heartbeat, released when it is destroyed.
#pragma once

#include <sys/eventfd.h>
#include <unistd.h>

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "wait.hpp"
#include "watcher.hpp"

namespace rorg {

// Movable, not copyable. It may outlive its client. A child after fork() may read it, and leaves it to its parent.
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
    if (!state_ || left_to_parent()) return;
    state_->stop();
    state_->tell("DELETE", "", state_->session->timeout, state_->session->patience);
    state_.reset();
  }
  // Lets go of it without releasing: for a request that another one with the same id has replaced.
  void abandon() {
    if (!state_ || left_to_parent()) return;
    state_->stop();
    state_.reset();
  }
  std::string id() const { return state_ ? state_->id : ""; }

  // Returns when its services and all that they need are ready; throws NotReady with what is missing, also when the
  // request is released meanwhile.
  Readiness wait(Seconds timeout = Seconds(30)) { return held().wait(timeout); }
  // The same as a future, which may be dropped.
  std::future<Readiness> wait_async(Seconds timeout = Seconds(30)) {
    held();
    return detail::in_background([state = state_, timeout] { return state->wait(timeout); });
  }

  // The last loss since it was made, or since wait() succeeded.
  std::optional<Loss> lost() const {
    return state_ && state_->process == ::getpid() ? state_->listener->loss() : std::nullopt;
  }
  // Calls back at each loss, on a thread of the client; an empty function ends that. Losses so far: see lost().
  void on_lost(const std::function<void(const Loss&)>& callback) {
    if (held().process == ::getpid()) state_->listener->hear(callback);
  }

 private:
  friend class Client;
  struct State {
    std::shared_ptr<detail::Session> session;
    std::string id, body;
    std::vector<std::string> services;
    Seconds ttl;
    std::shared_ptr<detail::Watcher> watcher;
    std::shared_ptr<detail::Listener> listener;
    const pid_t process = ::getpid();
    std::mutex mutex;
    std::condition_variable changed;
    bool over = false;
    const int released = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);  // ends the waits that are under way
    std::thread beat;

    State() = default;
    State(const State&) = delete;
    State& operator=(const State&) = delete;
    ~State() {
      if (released >= 0) ::close(released);
    }
    void stop() {
      const std::uint64_t one = 1;
      if (::write(released, &one, sizeof(one)) < 0) {
        // Then they end at their time.
      }
      listener->hear({});
      {
        std::lock_guard<std::mutex> guard(mutex);
        over = true;
      }
      changed.notify_all();
      if (beat.joinable()) beat.join();
    }
    Readiness wait(Seconds timeout) {
      try {
        auto found = detail::wait(*session, services, timeout, released);
        if (process == ::getpid()) listener->mended(found);
        return found;
      } catch (const detail::Stopped&) {
        throw NotReady("cannot wait for " + services.front(), "the request '" + id + "' was released", "a new request");
      }
    }
    detail::Answer tell(const std::string& method, const std::string& more, Seconds timeout, Seconds patience) {
      const bool put = method == "PUT";
      auto answer = session->call({method, "/v1/requests/" + detail::escaped(id) + more, put ? body : "", timeout,
                                   patience, true, put ? session->declared() : 0});
      if (answer.status >= 300) detail::raise(answer.status, answer.body);
      return answer;
    }
    void run() {
      const Seconds timeout = std::min(ttl / 3, session->timeout);
      std::unique_lock<std::mutex> lock(mutex);
      while (!changed.wait_for(lock, ttl / 3, [this] { return over; })) {
        lock.unlock();
        try {
          try {
            tell("POST", "/renew", timeout, Seconds(0));
          } catch (const NotFound& error) {
            listener->tell({"", "dropped", error.cause, ""});
            tell("PUT", "", timeout, Seconds(0));
          }
        } catch (const std::exception&) {
          // The next beat tries again: rorg may be restarting.
        }
        lock.lock();
      }
    }
  };
  explicit Request(std::shared_ptr<State> state) : state_(std::move(state)) {}

  State& held() const {
    if (!state_) throw Invalid("cannot use the request", "it was released", "a new one");
    return *state_;
  }
  // In a child after fork() it is not ours.
  bool left_to_parent() {
    if (state_->process == ::getpid()) return false;
    detail::leave_behind(std::move(state_));
    state_.reset();
    return true;
  }
  void release_quietly() noexcept {
    try {
      release();
    } catch (...) {
      // Nobody answered; the lease ends it.
    }
  }
  std::shared_ptr<State> state_;
};

}  // namespace rorg
