// rorg from C++17: request services, wait until they are ready, release them. Header-only; the standard library and
// POSIX sockets are all it needs (and OpenSSL for TLS, where that is wanted).
//
//   rorg::Client client;                                   // RORG_SOCKET, RORG_ADDRESS, or /run/rorg/rorg.sock
//   auto navigation = client.request({"navigation"});      // kept by a heartbeat, released by its destructor
//   navigation.wait(std::chrono::seconds(30));             // throws rorg::NotReady with what is missing
//   while (!navigation.lost()) drive();                    // it crashed, is held, was shed or restarted
//
// Calls are repeated while nobody answers, for the client's patience: a restart of rorg is no more than a longer wait.
// What a client changed, it then sees: its reads and waits are not answered from before its own changes.
#pragma once

#include "client.hpp"
