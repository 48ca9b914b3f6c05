// What must hold when things end early, divide, or go away. Each is a word on the command line of rorg_calls.
#pragma once

#include <sys/wait.h>

#include <random>

#include "check.hpp"

namespace faults {

using rorg::Client;
using rorg::Seconds;

inline bool known(Client& client, const std::string& id) {
  const auto all = client.requests();
  return std::any_of(all.items.begin(), all.items.end(), [&](const auto& one) { return one["id"].text() == id; });
}

// A request, its future and its callback outlive the client, each other, and the scope that made them.
inline void lifetimes() {
  std::optional<rorg::Request> orphan;
  std::future<rorg::Readiness> later;
  {
    Client client;
    orphan.emplace(client.request({"camera"}, "orphan", Seconds(0.5)));
    later = client.wait_async({"camera"}, Seconds(30));
    client.wait_async({"lidar"}, Seconds(0.3));  // dropped
  }
  check(later.get()["camera"].ready, "the future of a client that is gone");
  Client client;
  std::this_thread::sleep_for(std::chrono::milliseconds(1200));  // two leases long
  check(known(client, "orphan"), "it is kept without its client");
  auto ready = orphan->wait_async(Seconds(30));
  orphan.reset();
  check(!known(client, "orphan"), "and released");
  try {
    ready.get();
  } catch (const rorg::NotReady&) {
  }
  client.call("PUT", "/v1/suspension", R"({"duration":"60s","reason":"nothing becomes ready"})");
  auto never = client.request({"lidar"}, "never");
  auto pending = never.wait_async(Seconds(60));
  check(pending.wait_for(std::chrono::milliseconds(300)) == std::future_status::timeout, "it waits");
  never.release();
  check(pending.wait_for(std::chrono::seconds(30)) == std::future_status::ready, "a release ends its waits");
  throws<rorg::NotReady>([&] { pending.get(); }, "released", "and they say why");
  client.call("DELETE", "/v1/suspension");
  auto made = client.request_async({"camera"}, Seconds(30), "later");
  check(made.get().id() == "later", "a future of a request");
  check(within(10, [&] { return !known(client, "later"); }), "dropped with what was got");
  {
    const auto dropped = client.request_async({"camera"}, Seconds(30), "dropped");
  }
  check(within(20, [&] { return !known(client, "dropped"); }), "dropped with its future");

  // Many threads, one client; none waits for another's wait.
  const auto kept = client.request({"camera"}, "kept");
  const auto began = std::chrono::steady_clock::now();
  auto slow = client.wait_async({"lidar"}, Seconds(30));
  std::vector<std::thread> threads;
  for (const std::string name : {"camera", "lidar", "arm", "camera"})
    threads.emplace_back([&client, name] {
      for (int i = 0; i < 50; ++i) check(client.service(name)["service"].text() == name, "answers are not mixed up");
    });
  for (auto& thread : threads) thread.join();
  check(Seconds(std::chrono::steady_clock::now() - began).count() < 25, "a wait does not hold up other calls");
  const auto lidar = client.request({"lidar"});
  check(slow.get()["lidar"].ready, "and ends when it is ready");
}

// A child has connections of its own, and leaves alone what its parent holds.
// `busy`: while another thread makes calls. `threads`: and the child has some of its own. A sanitizer's allocator that is
// locked by another thread at the fork stays so in the child, so that not every build can do both.
inline void forks(bool busy, bool threads) {
  Client client;
  client.services();  // a connection that is kept
  auto request = client.request({"camera"}, "parents", Seconds(2));
  std::atomic<bool> over{false};
  std::thread other;
  if (busy) other = std::thread([&] {
    while (!over) client.service("arm");
  });
  for (int round = 0; round < 5; ++round) {
    const pid_t child = ::fork();
    if (child == 0) {
      ::alarm(60);  // ends it, should it hang
      int wrong = 0;
      for (int i = 0; i < 100; ++i) wrong += client.service("lidar")["service"].text() != "lidar";
      wrong += request.lost().has_value() + (request.id() != "parents");
      { const auto left = std::move(request); }
      if (threads) {
        auto own = client.request({"camera"}, "childs");
        own.wait(Seconds(30));
      }
      std::_Exit(wrong == 0 ? 0 : 1);
    }
    for (int i = 0; i < 100; ++i) check(client.service("camera")["service"].text() == "camera", "the parent's answers");
    int status = 1;
    ::waitpid(child, &status, 0);
    check(status == 0, "the child's answers");
  }
  over = true;
  if (busy) other.join();
  check(known(client, "parents"), "the parent's request is its own");
}

// Holds and waits while rorg ends and begins anew behind its back: `rounds` times.
inline void outages(int rounds) {
  Client client;
  auto request = client.request({"camera"}, "held", Seconds(5));
  request.wait();
  auto end = client.wait_async({"lidar"}, Seconds(90));  // pending all the time
  for (int round = 0; round < rounds; ++round) {
    say("go");
    for (bool told = false; !told;) {
      request.wait(Seconds(20));
      check(client.service("camera")["service"].text() == "camera", "a read");
      auto other = client.request({"camera"}, "other");
      other.wait(Seconds(20));
      other.release();
      pollfd input{0, POLLIN, 0};
      told = ::poll(&input, 1, 0) > 0;
    }
    hear();
  }
  check(known(client, "held"), "it is still held");
  const auto lidar = client.request({"lidar"});
  check(end.get()["lidar"].ready, "a wait through all of it");
}

// Requests, looks and releases at random intervals: while it holds it, what it was told is ready is so, in that run.
inline void cycles(int count, const std::string& name) {
  Client client;
  std::minstd_rand dice(static_cast<unsigned>(::getpid()));
  const auto pause = [&dice](unsigned most) { std::this_thread::sleep_for(std::chrono::milliseconds(dice() % most)); };
  for (int i = 0; i < count; ++i) {
    auto request = client.request({name});
    const auto run = request.wait(Seconds(60)).at(name).incarnation;
    for (unsigned look = 0; look < 2; ++look) {
      const auto now = client.service(name);
      check(now["state"].text() == "running" && now["incarnation"].text() == run && !request.lost(),
            "cycle " + std::to_string(i) + ": ready in " + run + ", found " + now["state"].text() + " in " +
                now["incarnation"].text());
      pause(20);
    }
    if (dice() % 4 == 0) client.restart(name, false, Seconds(60));
    request.release();
    pause(60);
  }
}

// Told of what becomes of a held service. The test kills it when told to go.
inline void losses() {
  Client client;
  auto request = client.request({"camera"}, "held");
  std::mutex mutex;
  std::vector<std::string> kinds;
  request.on_lost([&](const rorg::Loss& loss) {
    std::lock_guard<std::mutex> guard(mutex);
    kinds.push_back(loss.cause + " " + loss.service);
  });
  const auto heard = [&](const std::string& what) {
    return within(20, [&] {
      std::lock_guard<std::mutex> guard(mutex);
      return std::find(kinds.begin(), kinds.end(), what) != kinds.end();
    });
  };
  const auto first = request.wait()["camera"].incarnation;
  check(!request.lost(), "nothing is lost");
  say("kill");
  check(heard("crashed camera"), "the callback hears of a crash");
  const auto lost = request.lost();
  check(lost && lost->cause == "crashed" && lost->incarnation == first, "and lost() tells");
  hear();
  const auto second = request.wait(Seconds(60))["camera"].incarnation;
  check(!request.lost() && first != second, "a wait that succeeds withdraws it");
  client.restart("camera");
  check(heard("restarted camera"), "a restart is heard of");
  request.wait(Seconds(60));
  say("hold");
  hear();
  check(heard("held camera"), "a hold is heard of");
  client.call("DELETE", "/v1/holds/camera");
  request.wait(Seconds(60));
  client.release("held");  // behind its back
  check(within(20, [&] { return request.lost() && request.lost()->cause == "dropped"; }), "its own end is heard of");
  check(within(20, [&] { return known(client, "held"); }), "and it is made again");

  auto ending = std::make_shared<std::optional<rorg::Request>>(client.request({"camera"}, "ending"));
  const auto ended = std::make_shared<std::promise<void>>();
  (*ending)->on_lost([ending, ended](const rorg::Loss&) {
    ending->reset();  // in its own callback
    ended->set_value();
  });
  (*ending)->wait();
  client.restart("camera");
  check(ended->get_future().wait_for(std::chrono::seconds(30)) == std::future_status::ready, "ended by its callback");
}

// Told, once, of what became of a held service while rorg was away: by the cause that the test says.
inline void away(const std::string& cause) {
  Client client;
  auto request = client.request({"camera"}, "held", Seconds(60));
  std::mutex mutex;
  std::vector<std::string> told;
  request.on_lost([&](const rorg::Loss& loss) {
    std::lock_guard<std::mutex> guard(mutex);
    told.push_back(loss.cause + " " + loss.service + " " + loss.incarnation);
  });
  const auto run = request.wait()["camera"].incarnation;
  say("go");
  hear();
  check(within(60, [&] { return request.lost().has_value(); }), "it is told");
  for (int i = 0; i < 20; ++i) client.service("camera");  // what more there is would come meanwhile
  std::lock_guard<std::mutex> guard(mutex);
  check(told == std::vector<std::string>{cause + " camera " + run}, "told: " + (told.empty() ? "" : told.back()));
}

// Against a server that answers nonsense: any error is fine, and each call ends.
inline void nonsense(int rounds) {
  Client client(rorg::detail::default_address(), Seconds(0.15), Seconds(0));
  const std::string manifest = "kind: Service";
  for (int i = 0; i < rounds; ++i) {
    const auto began = std::chrono::steady_clock::now();
    try {
      switch (i % 8) {
        case 0: client.service("camera"); break;
        case 1: client.wait({"camera", "lidar"}, Seconds(0.1)); break;
        case 2: client.readiness({"camera"}); break;
        case 3: client.manifest("Service", "camera"); break;
        case 4: client.put_manifest("Service", "camera", manifest); break;
        case 5: client.restart("camera"); break;
        case 6: client.requests(); break;
        default: {
          auto request = client.request({"camera"}, "x", Seconds(0.06));
          within(0.03, [&] { return request.lost().has_value(); });
        }
      }
    } catch (const rorg::Error&) {
    }
    check(Seconds(std::chrono::steady_clock::now() - began).count() < 20, "a call that ends");
  }
}

}  // namespace faults
