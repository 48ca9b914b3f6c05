// As much HTTP/1.1 as rorg speaks. Whatever answers, a call ends: by an answer, an error, or its deadline.
#pragma once

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "stream.hpp"

namespace rorg::detail {

struct Answer {
  int status = 0;
  std::map<std::string, std::string> headers;  // names in small letters
  std::string body;
  std::string header(const std::string& name) const {
    const auto found = headers.find(name);
    return found == headers.end() ? "" : found->second;
  }
};

// A number written in digits; nothing for anything else.
inline std::optional<std::uint64_t> whole(const std::string& text, unsigned base = 10) {
  std::uint64_t found = 0;
  if (text.empty() || text.size() > 15) return std::nullopt;
  for (const char c : text) {
    const unsigned digit = c >= '0' && c <= '9' ? static_cast<unsigned>(c - '0')
                           : c >= 'a' && c <= 'f' ? static_cast<unsigned>(c - 'a') + 10
                           : c >= 'A' && c <= 'F' ? static_cast<unsigned>(c - 'A') + 10 : 99;
    if (digit >= base) return std::nullopt;
    found = found * base + digit;
  }
  return found;
}

// One connection; nothing is shared, nothing is repeated.
class Connection {
 public:
  explicit Connection(std::unique_ptr<Stream> stream) : stream_(std::move(stream)) {}

  Answer call(const std::string& method, const std::string& path, const std::string& headers, const std::string& body,
              Time deadline) {
    Answer answer = begin(method, path, headers, body, deadline);
    while (part(answer.body, deadline)) {
    }
    // What follows a whole answer belongs to none.
    reusable_ = form_ != Form::open && buffer_.empty() && answer.header("connection") != "close";
    return answer;
  }
  // The head of an answer whose body comes part by part.
  Answer begin(const std::string& method, const std::string& path, const std::string& headers, const std::string& body,
               Time deadline) {
    reusable_ = false;
    std::string text = method + " " + path + " HTTP/1.1\r\nhost: rorg\r\n" + headers;
    if (!body.empty()) text += "content-type: application/json\r\n";
    text += "content-length: " + std::to_string(body.size()) + "\r\n\r\n" + body;
    stream_->send(text.data(), text.size(), deadline);
    Answer answer;
    do answer = head(deadline);
    while (answer.status < 200);
    const auto length = whole(answer.header("content-length"));
    if (answer.status == 204 || answer.status == 304) {
      form_ = Form::counted, left_ = 0;
    } else if (answer.header("transfer-encoding").find("chunked") != std::string::npos) {
      form_ = Form::chunks, left_ = 0;
    } else if (length) {
      form_ = Form::counted, left_ = *length;
    } else if (answer.headers.count("content-length") != 0) {
      throw garbled("it does not say how long it is");
    } else {
      form_ = Form::open, left_ = 0;
    }
    if (left_ > most) throw garbled("it is too long");
    return answer;
  }
  // Appends the next part of the body; false at its end.
  bool part(std::string& into, Time deadline) {
    if (into.size() > most) throw garbled("it is too long");
    if (form_ == Form::chunks) return chunk(into, deadline);
    if (form_ == Form::counted && left_ == 0) return false;
    if (buffer_.empty()) {
      try {
        receive(deadline);
      } catch (const Lost& lost) {
        if (form_ == Form::open && !lost.late) return false;
        throw;
      }
    }
    const std::size_t count = form_ == Form::open ? buffer_.size() : std::min<std::size_t>(buffer_.size(), left_);
    into.append(buffer_, 0, count);
    buffer_.erase(0, count);
    left_ -= form_ == Form::open ? 0 : count;
    return true;
  }
  bool reusable() const { return reusable_; }
  void stop_at(int descriptor) { stream_->stop_at(descriptor); }

 private:
  enum class Form { counted, chunks, open };
  static constexpr std::size_t most = 64 << 20, longest_line = 64 << 10, most_lines = 1000;

  void receive(Time deadline) {
    char bytes[16384];
    buffer_.append(bytes, stream_->receive(bytes, sizeof(bytes), deadline));
  }
  std::string line(Time deadline) {
    std::size_t end, seen = 0;
    while ((end = buffer_.find("\r\n", seen)) == std::string::npos) {
      if (buffer_.size() > longest_line) throw garbled("a line is too long");
      seen = buffer_.empty() ? 0 : buffer_.size() - 1;
      receive(deadline);
    }
    std::string found = buffer_.substr(0, end);
    buffer_.erase(0, end + 2);
    return found;
  }
  Answer head(Time deadline) {
    Answer answer;
    const std::string first = line(deadline);
    const auto status = first.compare(0, 7, "HTTP/1.") == 0 && first.size() >= 12 ? whole(first.substr(9, 3)) : std::nullopt;
    if (!status || *status < 100) throw garbled("it is no HTTP");
    answer.status = static_cast<int>(*status);
    std::size_t count = 0;
    for (std::string one; !(one = line(deadline)).empty();) {
      const auto colon = one.find(':');
      if (colon == std::string::npos || ++count > most_lines) throw garbled("its headers are none");
      std::string name = one.substr(0, colon);
      std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return static_cast<char>(c < 128 ? std::tolower(c) : c); });
      const auto from = one.find_first_not_of(" \t", colon + 1), to = one.find_last_not_of(" \t");
      answer.headers[name] = from == std::string::npos ? "" : one.substr(from, to - from + 1);
    }
    return answer;
  }
  bool chunk(std::string& into, Time deadline) {
    const std::string size = line(deadline);
    const auto length = whole(size.substr(0, size.find_first_of("; \t")), 16);
    if (!length || *length > most) throw garbled("a part of it does not say how long it is");
    if (*length == 0) {
      for (std::size_t count = 0; !line(deadline).empty();)
        if (++count > most_lines) throw garbled("it does not end");
      return false;
    }
    while (buffer_.size() < *length + 2) receive(deadline);
    if (buffer_.compare(*length, 2, "\r\n") != 0) throw garbled("a part of it is longer than it says");
    into.append(buffer_, 0, *length);
    buffer_.erase(0, *length + 2);
    return true;
  }
  std::unique_ptr<Stream> stream_;
  std::string buffer_;
  Form form_ = Form::counted;
  std::uint64_t left_ = 0;
  bool reusable_ = false;
};

}  // namespace rorg::detail
