// Against a server that plays a script, and over TLS.
#pragma once

#include "check.hpp"

namespace scripts {

using rorg::Client;
using rorg::Seconds;

// What it sends is looked at by the test, call by call.
inline void scripted() {
  Client client;
  const auto copy = client;
  client.service("a");  // nothing was changed: not before nothing
  auto request = client.request({"a"}, "r", Seconds(60));
  client.service("b");
  client.put_manifest("Service", "c", "text");
  Client(copy).wait({"c"}, Seconds(5));  // copies know too
  client.release("other");
  auto found = client.wait({"a", "b"}, Seconds(30));  // ended with 503, then cut, then answered
  check(found["a"].ready && found["a"].incarnation == "run1", "which run is ready");
  try {
    client.wait({"a", "b"}, Seconds(1));
    check(false, "it is not ready");
  } catch (const rorg::NotReady& error) {
    check(error.services.at("a").ready && error.services.at("b").reason == "it starts", "the reason of each");
  }
  throws<rorg::Unreachable>([&] { client.restart("cut"); }, "cannot reach", "what may have arrived is not repeated");
  client.restart("ending");  // 503 says that it was not done
  client.restart("much");    // and so does 429
  client.restart("a", false, Seconds(5));
  throws<rorg::NotReady>([&] { client.wait({"late"}, Seconds(0.5)); }, "too late", "its time goes on while it is away");
  // Two outages with a second of peace between them are two: patience is for each.
  Client hasty(rorg::detail::default_address(), Seconds(5), Seconds(0.5));
  check(hasty.wait({"twice"}, Seconds(30))["twice"].ready, "through two outages");
  client.put_manifest("Service", "cut", "text of cut");
  client.remove_manifest("Service", "gone", "d1");
}

inline void secured() {
  Client client;
  auto request = client.request({"camera"}, "", Seconds(5));
  check(request.wait().at("camera").ready, "over TLS");
  check(client.wait_async({"camera"}, Seconds(10)).get().at("camera").ready, "in the background");
  for (int i = 0; i < 50; ++i) check(client.service("camera")["service"].text() == "camera", "many calls");
  rorg::Where where;
  const auto refused = [&](const std::string& what) {
    try {
      Client(where, Seconds(5), Seconds(0)).services();
    } catch (const rorg::Untrusted&) {
      return;
    } catch (const rorg::Unreachable&) {
      return;  // it hung up before its reason was read
    }
    check(false, what);
  };
  where.cert = where.key = "";
  refused("no certificate");
  where = {};
  where.ca = where.cert;
  throws<rorg::Untrusted>([&] { Client(where).services(); }, "cannot trust", "another authority");
  where = {};
  where.key = "/nowhere";
  throws<rorg::Untrusted>([&] { Client(where).services(); }, "/nowhere", "no key");
  where = {};
  where.address.replace(where.address.find("127.0.0.1"), 9, "localhost");
  throws<rorg::Untrusted>([&] { Client(where).services(); }, "mismatch", "another name");
}

// main() returns while threads are at work.
inline void left() {
  static Client client;
  static auto request = client.request({"camera"}, "last", Seconds(0.3));
  client.wait_async({"lidar"}, Seconds(20));
  std::thread([copy = client]() mutable {
    for (;;) copy.service("camera");
  }).detach();
}

}  // namespace scripts
