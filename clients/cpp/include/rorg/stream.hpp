// Bytes to and from rorg over a unix socket. Nothing blocks beyond its deadline.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <cmath>
#include <cstring>
#include <memory>
#include <string>

#include "address.hpp"
#include "text.hpp"

namespace rorg::detail {

// A stream was told to end by the descriptor that it watches.
struct Stopped {};

class Stream {
 public:
  virtual ~Stream() = default;
  // Some bytes, one at least.
  virtual std::size_t receive(char* into, std::size_t most, Time deadline) = 0;
  virtual void send(const char* bytes, std::size_t count, Time deadline) = 0;
  // From now on receive() throws Stopped once this descriptor can be read.
  virtual void stop_at(int descriptor) = 0;
};

// Owns a descriptor that does not block.
class Socket : public Stream {
 public:
  explicit Socket(int descriptor) : socket_(descriptor) {}
  ~Socket() override {
    if (socket_ >= 0) ::close(socket_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;

  std::size_t receive(char* into, std::size_t most, Time deadline) override {
    for (;;) {
      const auto count = ::recv(socket_, into, most, MSG_DONTWAIT);
      if (count > 0) return static_cast<std::size_t>(count);
      if (count == 0) throw Lost("it closed the connection", true);
      if (errno != EINTR) again(POLLIN, deadline, "receive");
    }
  }
  void send(const char* bytes, std::size_t count, Time deadline) override {
    while (count > 0) {
      const auto sent = ::send(socket_, bytes, count, MSG_NOSIGNAL | MSG_DONTWAIT);
      if (sent > 0) {
        bytes += sent;
        count -= static_cast<std::size_t>(sent);
      } else if (errno != EINTR) {
        again(POLLOUT, deadline, "send");
      }
    }
  }
  void stop_at(int descriptor) override { stop_ = descriptor; }
  int descriptor() const { return socket_; }

  // Until the socket is ready for these events of poll(2).
  void ready(short events, Time deadline, bool sent) {
    pollfd found[2] = {{socket_, events, 0}, {stop_, POLLIN, 0}};
    for (;;) {
      const double wait = std::ceil(left(deadline).count() * 1000);
      const int result = ::poll(found, stop_ >= 0 ? 2 : 1, wait > INT_MAX ? INT_MAX : static_cast<int>(wait));
      if (result < 0 && errno != EINTR) throw Lost(std::string("poll: ") + std::strerror(errno), sent);
      if (result > 0 && stop_ >= 0 && found[1].revents != 0) throw Stopped();
      if (result > 0) return;
      if (left(deadline).count() <= 0) throw Lost("no answer in time", sent, true);
    }
  }

 private:
  void again(short events, Time deadline, const char* what) {
    if (errno != EAGAIN && errno != EWOULDBLOCK) throw Lost(std::string(what) + ": " + std::strerror(errno), true);
    ready(events, deadline, true);
  }
  int socket_, stop_ = -1;
};

inline std::unique_ptr<Stream> open_unix(const std::string& path) {
  const auto slash = path.rfind('/');
  const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
  // A path may be longer than the 107 bytes of a socket address; an open directory stands for its folder.
  const int directory = ::open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC);
  if (directory < 0) throw Lost("no directory " + folder + ": " + std::strerror(errno), false);
  const std::string address = "/proc/self/fd/" + std::to_string(directory) + "/" + path.substr(slash + 1);
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  std::strncpy(name.sun_path, address.c_str(), sizeof(name.sun_path) - 1);
  const int made = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const int result = made < 0 ? -1 : ::connect(made, reinterpret_cast<sockaddr*>(&name), sizeof(name));
  const int error = errno;
  ::close(directory);
  auto found = std::make_unique<Socket>(made);
  if (result != 0) throw Lost(path + ": " + std::strerror(error), false);
  return found;
}

}  // namespace rorg::detail
