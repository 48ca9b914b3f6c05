// Times calls: rorg_latency query|put CLIENTS CALLS. Prints median and 95th percentile in milliseconds.
#include <algorithm>
#include <cstdio>

#include "rorg/rorg.hpp"

int main(int argc, char** argv) {
  if (argc != 4) return 2;
  const bool put = std::string(argv[1]) == "put";
  const int clients = std::atoi(argv[2]), calls = std::atoi(argv[3]);
  std::vector<std::vector<double>> found(static_cast<std::size_t>(clients));
  std::vector<std::thread> threads;
  for (int n = 0; n < clients; ++n) {
    threads.emplace_back([&, n] {
      rorg::Client client;
      const std::string path = "/v1/requests/latency-" + std::to_string(n);
      for (int i = 0; i < calls; ++i) {
        const auto began = std::chrono::steady_clock::now();
        if (put) {
          client.call("PUT", path, "{\"services\":[\"camera\"],\"reason\":\"" + std::to_string(i) + "\"}");
        } else {
          client.service("camera");
        }
        found[static_cast<std::size_t>(n)].push_back(
            std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began).count());
      }
      if (put) client.call("DELETE", path);
    });
  }
  for (auto& thread : threads) thread.join();
  std::vector<double> all;
  for (const auto& part : found) all.insert(all.end(), part.begin(), part.end());
  std::sort(all.begin(), all.end());
  std::printf("%.3f %.3f\n", all[all.size() / 2], all[all.size() * 95 / 100]);
}
