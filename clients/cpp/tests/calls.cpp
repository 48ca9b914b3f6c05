// The client against a running rorg; exits 0 when each thing did what it says. Without a word, every call: services are
// camera, lidar, and arm, which is a driver and conflicts with lidar. With a word, one of faults.hpp or scripts.hpp.
#include "check.hpp"
#include "faults.hpp"
#include "scripts.hpp"

namespace {

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

void manifests(rorg::Client& client) {
  const auto lidar = client.manifest("Service", "lidar");
  check(lidar.text.find("name: lidar") != std::string::npos && !lidar.digest.empty(), "a manifest is read");
  std::string text = lidar.text;
  text.replace(text.find("name: lidar"), 11, "name: sonar");
  const auto digest = client.put_manifest("Service", "sonar", text);
  check(client.manifest("Service", "sonar").digest == digest, "a manifest is put");
  check(client.manifests().size() == 4, "and listed");
  throws<rorg::Refused>([&] { client.put_manifest("Service", "sonar", text + "\n"); }, "already", "without its base");
  const std::string bad = text + "  colour: red\n";
  throws<rorg::Invalid>([&] { client.put_manifest("Service", "sonar", bad, digest); }, "colour", "a bad one");
  const auto changed = client.put_manifest("Service", "sonar", text + "# better\n", digest, "better");
  check(changed != digest, "and changed");
  client.remove_manifest("Service", "sonar", changed);
  throws<rorg::NotFound>([&] { client.manifest("Service", "sonar"); }, "no such Service", "and removed");
}

void names(rorg::Client& client) {
  const std::string longer(65, 'a');
  const std::vector<std::string> all{"a/b", "..", "a b", "", "-a", "x?y=1", longer, "caf\xc3\xa9"};
  for (const std::string& bad : all) {
    if (!bad.empty()) throws<rorg::Invalid>([&] { client.request({"camera"}, bad); }, "invalid id", "the id " + bad);
    throws<rorg::Invalid>([&] { client.release(bad); }, "invalid id", "to release " + bad);
    throws<rorg::Invalid>([&] { client.request({bad}); }, "invalid name", "to request " + bad);
    for (const auto& call : {std::function<void()>([&] { client.service(bad); }), {[&] { client.why(bad); }},
                             {[&] { client.restart(bad); }}, {[&] { client.wait({bad}, rorg::Seconds(0)); }},
                             {[&] { client.manifest("Service", bad); }}, {[&] { client.manifest(bad, "camera"); }}})
      throws<rorg::Invalid>(call, "invalid name", "the name " + bad);
  }
  throws<rorg::Invalid>([&] { client.request({}); }, "no service", "nothing");
  for (const char* bad : {"", "http://robot:1", "https://robot", "https://:1", "https://robot:x", "unix://"})
    throws<rorg::Invalid>([&] { rorg::Client(bad).services(); }, "no address", bad);
  check(rorg::Client("unix://" + client.address()).services().size() > 3, "an address of a socket");
}

void calls() {
  std::locale::global(std::locale(std::locale::classic(), new German));
  json();
  rorg::Client client;
  {
    auto request = client.request({"camera"}, "", rorg::Seconds(5), "look");
    check(request.wait(rorg::Seconds(20)).at("camera").ready, "how ready each is");
    check(client.service("camera")["health"].text() == "Healthy", "it is ready");
    check(client.requests().size() >= 1 && client.why("camera")[0]["wanted"].flag, "why");
    auto found = client.readiness({"camera", "lidar"});
    check(found["camera"].ready && !found["lidar"].ready && !found["lidar"].reason.empty(), "readiness of each");
    for (int i = 0; i < 20; ++i) check(client.readiness({"camera"})["camera"].ready, "readiness while it is held");
    const auto before = request.wait()["camera"].incarnation;
    client.restart("camera", false, rorg::Seconds(20));
    check(request.wait()["camera"].incarnation != before && !before.empty(), "restarted, and waited for the new run");
    auto moved = std::move(request);
    check(request.id().empty() && !moved.id().empty(), "moved");
    throws<rorg::Invalid>([&] { request.wait(); }, "released", "moved from");
  }
  check(client.requests().size() == 0, "released by the destructor");
  throws<rorg::Error>([&] { client.call("GET", "/v1/events?tail=3"); }, "cannot read", "lines are no JSON");
  check(client.service("lidar")["service"].text() == "lidar", "an answer in chunks is read to its end");
  {
    const auto kept = client.request({"camera"}, "short", rorg::Seconds(0.4));
    std::this_thread::sleep_for(std::chrono::milliseconds(1300));  // three leases long
    check(client.requests().size() == 1, "the heartbeat keeps it");
  }
  {
    auto arm = client.request({"arm"}, "hardware");
    arm.wait(rorg::Seconds(20));
    throws<rorg::Refused>([&] { client.restart("arm"); }, "moves hardware", "a driver");
  }
  const auto lidar = client.request({"lidar"}, "first");
  throws<rorg::Refused>([&] { client.request({"arm"}); }, "conflict", "a conflict");
  throws<rorg::Invalid>([&] { client.request({"camra"}); }, "try 'camera'", "a typo");
  throws<rorg::NotFound>([&] { client.service("nobody"); }, "no such service", "an unknown service");
  throws<rorg::Refused>([&] { client.restart("arm"); }, "not wanted", "a restart of what nobody requests");
  throws<rorg::NotReady>([&] { client.wait({"camera"}, rorg::Seconds(0.1)); }, "camera", "a wait without a request");
  client.release("nothing");
  names(client);
  manifests(client);
  rorg::Client nobody("/nowhere/rorg.sock", rorg::Seconds(1), rorg::Seconds(0.1));
  throws<rorg::Unreachable>([&] { nobody.services(); }, "cannot reach rorg", "nobody there");
}

}  // namespace

int main(int argc, char** argv) {
  const std::string word = argc > 1 ? argv[1] : "calls";
  const int count = argc > 2 ? std::atoi(argv[2]) : 1;
  try {
    if (word == "calls") calls();
    else if (word == "lifetimes") faults::lifetimes();
    else if (word == "forks") faults::forks((count & 1) != 0, (count & 2) != 0);
    else if (word == "outages") faults::outages(count);
    else if (word == "cycles") faults::cycles(count, argc > 3 ? argv[3] : "camera");
    else if (word == "losses") faults::losses();
    else if (word == "away") faults::away(argv[2]);
    else if (word == "nonsense") faults::nonsense(count);
    else if (word == "scripted") scripts::scripted();
    else if (word == "secured") scripts::secured();
    else if (word == "left") scripts::left();
    else return 2;
  } catch (const std::exception& error) {
    check(false, word + " threw " + error.what());
  }
  return failures == 0 ? 0 : 1;
}
