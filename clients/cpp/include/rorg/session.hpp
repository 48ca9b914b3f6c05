// What the copies of a client, its requests and its futures share: where rorg is, connections to it, and what this
// program has changed. It lives as long as any of them.
#pragma once

#include <unistd.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "http.hpp"
#include "tls.hpp"

namespace rorg::detail {

class Watcher;

// What a child after fork() has of its parent and must neither use nor destroy: threads that are not there, locks that
// they hold, connections on which the parent speaks.
inline void leave_behind(std::shared_ptr<void> thing) {
  static auto* const mutex = new std::mutex;
  static auto* const things = new std::vector<std::shared_ptr<void>>;
  std::lock_guard<std::mutex> guard(*mutex);
  things->push_back(std::move(thing));
}

// One call of the API, and how it may be repeated.
struct Call {
  std::string method, path, body;
  Seconds timeout, patience;
  bool repeatable;                   // else only when it surely did not arrive
  std::uint64_t not_before = 0;      // a generation
  std::optional<Time> until = {};    // of a wait: what is left is sent as its timeout
  int stop = -1;                     // a descriptor; once it can be read the call throws Stopped
};

// Time in which nobody answers, from the first failure on.
class Outage {
 public:
  explicit Outage(Seconds patience) : end_(in(patience)), patience_(patience) {}
  // Sleeps until the next attempt, so long at the least; false when patience has run out.
  bool goes_on(Seconds after = Seconds(0)) {
    if (!begun_) end_ = in(patience_);
    begun_ = true;
    const Seconds pause = std::max(pause_, after);
    if (left(end_) < pause) return false;
    std::this_thread::sleep_for(pause);
    pause_ = std::min(pause_ * 2, Seconds(1));
    return true;
  }
  // Somebody was there for a while: what comes is another one.
  void over() { *this = Outage(patience_); }

 private:
  Time end_;
  Seconds patience_, pause_{0.1};
  bool begun_ = false;
};

class Session {
 public:
  Session(Where where, Seconds timeout, Seconds patience)
      : where(std::move(where)), timeout(timeout), patience(patience), local_(new Local) {}
  ~Session() {
    auto* const found = local_.load();
    if (found->process == ::getpid()) delete found;
    else leave_behind(std::shared_ptr<Local>(found));
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  const Where where;
  const Seconds timeout, patience;

  // The answer, which may say no, but never "not now": that is repeated, as is a connection that fails.
  Answer call(const Call& call) {
    Outage outage(call.patience);
    for (;;) {
      pollfd end{call.stop, POLLIN, 0};
      if (call.stop >= 0 && ::poll(&end, 1, 0) > 0) throw Stopped();
      bool kept = false;
      const Time began = std::chrono::steady_clock::now();
      const auto lasted = [began] { return Seconds(std::chrono::steady_clock::now() - began); };
      try {
        Answer answer = once(call, kept);
        if (!not_now(answer)) return answer;
        if (lasted() > longest_hold) outage.over();
        if (!outage.goes_on(pause_of(answer))) raise(answer.status, answer.body);
      } catch (const Lost& lost) {
        // One that was kept may have been closed meanwhile, which says nothing of who is there now.
        if (kept && !lost.late && call.repeatable) continue;
        if (lost.sent && !lost.late && lasted() > Seconds(1)) outage.over();
        if ((lost.sent && !call.repeatable) || !outage.goes_on()) throw;
      }
    }
  }

  // The newest change that this program has made, and the newest of a manifest.
  std::uint64_t changed() const { return changed_; }
  std::uint64_t declared() const { return declared_; }

  std::unique_ptr<Connection> connect(Time deadline) const {
    return std::make_unique<Connection>(open_stream(where, deadline));
  }
  // The watcher of this process, or a new one.
  template <typename Make>
  std::shared_ptr<Watcher> watcher(Make make) {
    Local& own = local();
    std::lock_guard<std::mutex> guard(own.mutex);
    auto found = own.watcher.lock();
    if (!found) own.watcher = found = make();
    return found;
  }

 private:
  // What belongs to one process.
  struct Local {
    const pid_t process = ::getpid();
    std::mutex mutex;
    std::vector<std::unique_ptr<Connection>> idle;
    std::weak_ptr<Watcher> watcher;
  };
  static constexpr std::size_t most_idle = 4;
  // rorg holds back an answer that must know of a change for so long, and then says 503.
  static constexpr Seconds longest_hold{11};

  // It was not done: rorg is busy, or this program asks too much.
  static bool not_now(const Answer& answer) { return answer.status == 503 || answer.status == 429; }
  // Who asks too much is told when to come again.
  static Seconds pause_of(const Answer& answer) {
    const auto told = answer.status == 429 ? whole(answer.header("retry-after")) : std::nullopt;
    return Seconds(told ? static_cast<double>(std::min<std::uint64_t>(*told, 3600)) : 0.0);
  }

  Local& local() {
    Local* found = local_;
    if (found->process == ::getpid()) return *found;
    auto fresh = std::make_unique<Local>();
    if (local_.compare_exchange_strong(found, fresh.get())) {
      leave_behind(std::shared_ptr<Local>(found));
      return *fresh.release();
    }
    return *found;
  }
  Answer once(const Call& call, bool& kept) {
    const Time deadline = in((call.until ? left(*call.until) : Seconds(0)) + call.timeout);
    std::unique_ptr<Connection> connection;
    Local& own = local();
    if (call.repeatable) {
      std::lock_guard<std::mutex> guard(own.mutex);
      if (!own.idle.empty()) {
        connection = std::move(own.idle.back());
        own.idle.pop_back();
      }
    }
    kept = connection != nullptr;
    if (!kept) connection = connect(deadline);
    connection->stop_at(call.stop);
    std::string headers;
    if (call.not_before != 0) headers = "rorg-not-before: " + std::to_string(call.not_before) + "\r\n";
    const std::string path = call.path + (call.until ? "&timeout=" + written(left(*call.until)) : "");
    Answer answer = connection->call(call.method, path, headers, call.body, deadline);
    if (const auto generation = whole(answer.header("rorg-generation"))) note(*generation, call);
    if (connection->reusable() && !not_now(answer)) {
      std::lock_guard<std::mutex> guard(own.mutex);
      if (own.idle.size() < most_idle) own.idle.push_back(std::move(connection));
    }
    return answer;
  }
  void note(std::uint64_t generation, const Call& call) {
    raise_to(changed_, generation);
    if (call.path.compare(0, 14, "/v1/manifests/") == 0) raise_to(declared_, generation);
  }
  static void raise_to(std::atomic<std::uint64_t>& value, std::uint64_t wanted) {
    for (auto now = value.load(); now < wanted && !value.compare_exchange_weak(now, wanted);) {
    }
  }
  std::atomic<Local*> local_;
  std::atomic<std::uint64_t> changed_{0}, declared_{0};
};

}  // namespace rorg::detail
