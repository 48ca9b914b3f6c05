// TLS over TCP, by OpenSSL; only with RORG_WITH_TLS, which the CMake option of that name sets.
#pragma once

#include "stream.hpp"

#ifdef RORG_WITH_TLS

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>

namespace rorg::detail {

template <auto F>
struct Freed {
  template <typename T>
  void operator()(T* found) const { F(found); }
};

// OpenSSL sees memory alone, not the socket: sending never raises SIGPIPE, and each step has its deadline.
class Tls : public Stream {
 public:
  Tls(std::unique_ptr<Socket> socket, const Where& where, const std::string& host, Time deadline)
      : socket_(std::move(socket)) {
    // Not taken down when main() returns: a thread may still be at work.
    static const bool begun = OPENSSL_init_ssl(OPENSSL_INIT_NO_ATEXIT, nullptr) == 1;
    ERR_clear_error();
    context_.reset(begun ? SSL_CTX_new(TLS_client_method()) : nullptr);
    if (!context_) untrusted("OpenSSL does not begin");
    // Read anew for each connection: certificates are renewed while programs run.
    SSL_CTX_set_min_proto_version(context_.get(), TLS1_2_VERSION);
    SSL_CTX_set_verify(context_.get(), SSL_VERIFY_PEER, nullptr);
    if ((where.ca.empty() ? SSL_CTX_set_default_verify_paths(context_.get())
                          : SSL_CTX_load_verify_locations(context_.get(), where.ca.c_str(), nullptr)) != 1)
      untrusted("the authority's file " + where.ca + " cannot be read");
    if (!where.cert.empty() && SSL_CTX_use_certificate_chain_file(context_.get(), where.cert.c_str()) != 1)
      untrusted("the certificate " + where.cert + " cannot be read");
    const std::string& key = where.key.empty() ? where.cert : where.key;
    if (!key.empty() && SSL_CTX_use_PrivateKey_file(context_.get(), key.c_str(), SSL_FILETYPE_PEM) != 1)
      untrusted("the key " + key + " cannot be read, or is of another certificate");
    tls_.reset(SSL_new(context_.get()));
    from_ = BIO_new(BIO_s_mem());
    to_ = BIO_new(BIO_s_mem());
    SSL_set_bio(tls_.get(), from_, to_);  // now owned by tls_
    name(host);
    while (const int wanted = step(SSL_connect(tls_.get()))) move(wanted, deadline, false);
    flush(deadline);
  }
  std::size_t receive(char* into, std::size_t most, Time deadline) override {
    for (;;) {
      ERR_clear_error();
      const int count = SSL_read(tls_.get(), into, most > INT_MAX ? INT_MAX : static_cast<int>(most));
      if (count > 0) return static_cast<std::size_t>(count);
      move(step(count), deadline, true);
    }
  }
  void send(const char* bytes, std::size_t count, Time deadline) override {
    ERR_clear_error();
    while (const int wanted = step(SSL_write(tls_.get(), bytes, static_cast<int>(count)))) move(wanted, deadline, true);
    flush(deadline);
  }
  void stop_at(int descriptor) override { socket_->stop_at(descriptor); }

 private:
  // 0 when done, else what it waits for.
  int step(int result) {
    if (result > 0) return 0;
    const int wanted = SSL_get_error(tls_.get(), result);
    if (wanted == SSL_ERROR_WANT_READ || wanted == SSL_ERROR_WANT_WRITE) return wanted;
    if (wanted == SSL_ERROR_ZERO_RETURN) throw Lost("it closed the connection", true);
    const long verdict = SSL_get_verify_result(tls_.get());
    if (verdict != X509_V_OK) untrusted(X509_verify_cert_error_string(verdict));
    untrusted("the handshake failed");
  }
  void move(int wanted, Time deadline, bool sent) {
    flush(deadline);
    if (wanted == SSL_ERROR_WANT_WRITE) return;
    char bytes[16384];
    try {
      const auto count = socket_->receive(bytes, sizeof(bytes), deadline);
      BIO_write(from_, bytes, static_cast<int>(count));
    } catch (Lost& lost) {
      lost.sent = sent;
      throw;
    }
  }
  void flush(Time deadline) {
    char bytes[16384];
    for (int count; (count = BIO_read(to_, bytes, sizeof(bytes))) > 0;)
      socket_->send(bytes, static_cast<std::size_t>(count), deadline);
  }
  void name(const std::string& host) {
    unsigned char binary[sizeof(in6_addr)];
    const bool number = ::inet_pton(AF_INET, host.c_str(), binary) == 1 || ::inet_pton(AF_INET6, host.c_str(), binary) == 1;
    const bool named = number ? X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls_.get()), host.c_str()) == 1
                              : SSL_set1_host(tls_.get(), host.c_str()) == 1 &&
                                    SSL_set_tlsext_host_name(tls_.get(), host.c_str()) == 1;
    if (!named) untrusted("'" + host + "' is no name of a host");
  }
  [[noreturn]] static void untrusted(const std::string& why) {
    const auto code = ERR_get_error();
    const char* more = code ? ERR_reason_error_string(code) : nullptr;
    ERR_clear_error();
    throw Untrusted("cannot trust the connection to rorg", why + (more ? std::string(" (") + more + ")" : ""),
                    "RORG_CA, RORG_CERT and RORG_KEY");
  }
  std::unique_ptr<Socket> socket_;
  std::unique_ptr<SSL_CTX, Freed<SSL_CTX_free>> context_;
  std::unique_ptr<SSL, Freed<SSL_free>> tls_;
  BIO *from_ = nullptr, *to_ = nullptr;
};

inline std::unique_ptr<Socket> open_tcp(const Place& place, Time deadline) {
  addrinfo hints{}, *list = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  const int failed = ::getaddrinfo(place.host.c_str(), place.port.c_str(), &hints, &list);
  if (failed != 0) throw Lost(place.host + ": " + ::gai_strerror(failed), false);
  const std::unique_ptr<addrinfo, Freed<::freeaddrinfo>> all(list);
  std::string why = "no address";
  for (const addrinfo* one = list; one != nullptr; one = one->ai_next) {
    auto made = std::make_unique<Socket>(::socket(one->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (made->descriptor() < 0) continue;
    int error = 0;
    if (::connect(made->descriptor(), one->ai_addr, one->ai_addrlen) != 0 && (error = errno) == EINPROGRESS) {
      made->ready(POLLOUT, deadline, false);
      socklen_t size = sizeof(error);
      ::getsockopt(made->descriptor(), SOL_SOCKET, SO_ERROR, &error, &size);
    }
    if (error == 0) {
      const int on = 1;
      ::setsockopt(made->descriptor(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
      // Who only listens hears by this that a robot has lost its power.
      ::setsockopt(made->descriptor(), SOL_SOCKET, SO_KEEPALIVE, &on, sizeof(on));
      return made;
    }
    why = std::strerror(error);
  }
  throw Lost(place.host + ":" + place.port + ": " + why, false);
}

}  // namespace rorg::detail

#endif

namespace rorg::detail {

inline std::unique_ptr<Stream> open_stream(const Where& where, [[maybe_unused]] Time deadline) {
  const Place place(where.address);
  if (!place.path.empty()) return open_unix(place.path);
#ifdef RORG_WITH_TLS
  return std::make_unique<Tls>(open_tcp(place, deadline), where, place.host, deadline);
#else
  throw Invalid("cannot reach rorg on " + where.address, "this program was built without TLS",
                "the CMake option RORG_WITH_TLS");
#endif
}

}  // namespace rorg::detail
