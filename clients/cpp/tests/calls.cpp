// Every call of the client against a running rorg; exits 0 when each did what it says. Services: camera, lidar, and arm,
// which is a driver and conflicts with lidar.
#include <iostream>

#include "rorg/rorg.hpp"

namespace {

int failures = 0;

void check(bool good, const std::string& what) {
  if (!good) {
    ++failures;
    std::cerr << "FAILED: " << what << std::endl;
  }
}

template <typename E, typename F>
void throws(F call, const std::string& part, const std::string& what) {
  try {
    call();
  } catch (const E& error) {
    check(std::string(error.what()).find(part) != std::string::npos, what + ": " + error.what());
    return;
  } catch (const std::exception& error) {
    check(false, what + " threw " + error.what());
    return;
  }
  check(false, what + " threw nothing");
}

void json() {
  const auto value = rorg::json::parse(R"({"a":[1,-2.5e1,true,false,null],"t":"x\n\"\u00e9\ud83d\ude00"})");
  check(value["a"][1].number == -25 && bool(value["a"][2]) && !bool(value["a"][3]) && value["a"][4].is_null(), "json");
  check(value["t"].text() == "x\n\"\u00e9\U0001F600", "json text");
  check(value["b"]["c"][3].is_null(), "what is not there is null");
  check(rorg::json::parse("[0.5,12345.25]")[1].number == 12345.25, "numbers in any locale");
  for (const char* bad : {"", "{", "[1,", "\"x", "{\"a\"}", "nul", "[1] 2"})
    throws<rorg::json::Error>([bad] { rorg::json::parse(bad); }, "", bad);
  check(rorg::json::quoted("a\"b\\\n") == "\"a\\\"b\\\\\\u000a\"", "quoted");
}

// As in a German program: 0,5 and 1.000.
struct German : std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\3"; }
};

}  // namespace

int main() {
  std::locale::global(std::locale(std::locale::classic(), new German));
  json();
  rorg::Client client;
  {
    auto request = client.request({"camera"}, "", rorg::Seconds(5), "look");
    client.wait({"camera"}, rorg::Seconds(20));
    check(client.service("camera")["health"].text() == "Healthy", "it is ready");
    check(client.requests().size() >= 1 && client.why("camera")[0]["wanted"].flag, "why");
    auto moved = std::move(request);
    check(request.id().empty() && !moved.id().empty(), "moved");
  }
  check(client.requests().size() == 0, "released by the destructor");
  throws<rorg::Error>([&] { client.call("GET", "/v1/events?tail=3"); }, "cannot read", "lines are no JSON");
  check(client.service("lidar")["service"].text() == "lidar", "an answer in chunks is read to its end");
  {
    const auto kept = client.request({"camera"}, "short", rorg::Seconds(0.6));
    std::this_thread::sleep_for(std::chrono::seconds(2));  // three leases long
    check(client.requests().size() == 1, "the heartbeat keeps it");
  }
  const auto lidar = client.request({"lidar"}, "first");
  throws<rorg::Refused>([&] { client.request({"arm"}); }, "conflict", "a conflict");
  throws<rorg::Invalid>([&] { client.request({"camra"}); }, "try 'camera'", "a typo");
  throws<rorg::NotFound>([&] { client.service("nobody"); }, "none of that name", "an unknown service");
  throws<rorg::Refused>([&] { client.restart("arm"); }, "moves hardware", "a driver");
  throws<rorg::NotReady>([&] { client.wait({"camera"}, rorg::Seconds(0.1)); }, "camera", "a wait without a request");
  client.release("nothing");
  rorg::Client nobody("/nowhere/rorg.sock", rorg::Seconds(1), rorg::Seconds(0.1));
  throws<rorg::Unreachable>([&] { nobody.services(); }, "cannot reach rorg", "nobody there");
  return failures == 0 ? 0 : 1;
}
