// For each service named on a line of its input: requests it, waits, says so; at the next line releases it.
#include <iostream>
#include <rorg/rorg.hpp>
#include <string>

int main(int, char** argv) {
  rorg::Client client(argv[1]);
  for (std::string service, next; std::getline(std::cin, service);) {
    try {
      auto request = client.request({service});
      client.wait({service}, rorg::Seconds(60));
      std::cout << "ready" << std::endl;
      std::getline(std::cin, next);
      request.release();
      std::cout << "released" << std::endl;
    } catch (const rorg::Error& error) {
      std::cout << "error " << error.what() << std::endl;
    }
  }
}
