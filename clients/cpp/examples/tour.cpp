// A behaviour in C++: plays actions one after another, each given as `NAME=SERVICE,SERVICE...`. When an action's services
// are ready it writes the file DIRECTORY/ready-NAME, and goes on once DIRECTORY/next-NAME is there.
#include <fstream>
#include <iostream>
#include <sstream>

#include "rorg/rorg.hpp"

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  const std::string directory = argv[1];
  rorg::Client client;
  std::optional<rorg::Request> request;
  for (int i = 2; i < argc; ++i) {
    const std::string word = argv[i];
    const auto equals = word.find('=');
    const std::string name = word.substr(0, equals);
    std::vector<std::string> services;
    std::stringstream list(word.substr(equals + 1));
    for (std::string service; std::getline(list, service, ',');) services.push_back(service);
    try {
      // The same id again replaces the request before: what both actions use goes on without a gap.
      auto next = client.request(services, "tour", rorg::Seconds(10), name);
      if (request) request->abandon();
      request.emplace(std::move(next));
      client.wait(services, rorg::Seconds(60));
    } catch (const rorg::Error& error) {
      std::cerr << error.what() << std::endl;
      return 1;
    }
    std::ofstream(directory + "/ready-" + name) << name << std::endl;
    while (!std::ifstream(directory + "/next-" + name)) std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}
