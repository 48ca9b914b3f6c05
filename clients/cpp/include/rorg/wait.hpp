// Waiting for services, here or in the background.
#pragma once

#include <future>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "session.hpp"

namespace rorg::detail {

// Until services and all that they need are ready. Its time goes on while rorg is away; who is there again is asked
// once more, with what is left. Throws Stopped once the descriptor `stop` can be read.
inline Readiness wait(Session& session, const std::vector<std::string>& services, Seconds timeout, int stop = -1) {
  std::string query;
  for (const auto& service : services) query += (query.empty() ? "services=" : "&services=") + escaped(service);
  const auto answer = session.call({"GET", "/v1/wait?" + query, "", session.timeout, session.patience, true,
                                    session.changed(), in(timeout), stop});
  if (answer.status >= 300) raise(answer.status, answer.body);
  auto found = readiness(parsed(answer.body));
  if (found.empty())
    for (const auto& service : services) found[service].ready = true;
  return found;
}

// Runs a call on a thread of its own. Unlike that of std::async, the future does not wait when it is destroyed.
template <typename F>
auto in_background(F call) -> std::future<std::invoke_result_t<F>> {
  std::packaged_task<std::invoke_result_t<F>()> task(std::move(call));
  auto future = task.get_future();
  std::thread(std::move(task)).detach();
  return future;
}

}  // namespace rorg::detail
