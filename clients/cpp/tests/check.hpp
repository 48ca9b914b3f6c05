// What the tests' programs share: counting failures.
#pragma once

#include <iostream>
#include <string>

#include "rorg/rorg.hpp"

inline int failures = 0;

inline void check(bool good, const std::string& what) {
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

// Polls a condition for at most so many seconds.
template <typename F>
bool within(double seconds, F condition) {
  const auto end = rorg::detail::in(rorg::Seconds(seconds));
  while (rorg::detail::left(end).count() > 0) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return condition();
}

// Tells the test that something is so, or hears from it.
inline void say(const std::string& word) { std::cout << word << std::endl; }
inline void hear() {
  std::string line;
  std::getline(std::cin, line);
}
