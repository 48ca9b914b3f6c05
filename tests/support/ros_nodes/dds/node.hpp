// A ROS 2 node without ROS: a participant as rmw_fastrtps makes it, and the type std_msgs/msg/String on its wire.
#pragma once

#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

namespace fastdds = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

constexpr int MESSAGES = 50;
constexpr std::size_t LONGEST = 1024;  // bytes of a text

// std_msgs/msg/String: the encapsulation, the length with the zero at the end, the bytes.
class StringType : public fastdds::TopicDataType {
 public:
  StringType() {
    setName("std_msgs::msg::dds_::String_");
    m_typeSize = 4 + 4 + LONGEST;
    m_isGetKeyDefined = false;
  }

  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
    eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR);
    payload->encapsulation = cdr.endianness() == eprosima::fastcdr::Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
    cdr.serialize_encapsulation();
    cdr << *static_cast<std::string*>(data);
    payload->length = static_cast<std::uint32_t>(cdr.getSerializedDataLength());
    return true;
  }

  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    eprosima::fastcdr::FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
    eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR);
    cdr.read_encapsulation();
    payload->encapsulation = cdr.endianness() == eprosima::fastcdr::Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
    cdr >> *static_cast<std::string*>(data);
    return true;
  }

  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<std::uint32_t>(4 + 4 + static_cast<std::string*>(data)->size() + 1); };
  }

  void* createData() override { return new std::string; }
  void deleteData(void* data) override { delete static_cast<std::string*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

inline std::string variable(const char* name, const char* otherwise) {
  const char* found = std::getenv(name);
  return found != nullptr && *found != '\0' ? found : otherwise;
}

// What rmw_fastrtps makes of ROS_LOCALHOST_ONLY (Humble and before): UDP on the loopback interface, and shared memory.
inline void only_localhost(fastdds::DomainParticipantQos& qos) {
  qos.transport().use_builtin_transports = false;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.emplace_back("127.0.0.1");
  qos.transport().user_transports.push_back(udp);
  qos.transport().user_transports.push_back(
      std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>());
}

// What it makes of ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST (Iron and later): no multicast, and this machine as a peer.
inline void discover_localhost(fastdds::DomainParticipantQos& qos) {
  auto& builtin = qos.wire_protocol().builtin;
  builtin.metatrafficMulticastLocatorList.clear();
  builtin.metatrafficUnicastLocatorList.push_back(rtps::Locator_t());
  rtps::Locator_t peer;
  rtps::IPLocator::setIPv4(peer, "127.0.0.1");
  builtin.initialPeersList.push_back(peer);
}

// In the domain of ROS_DOMAIN_ID. ROS_DISTRO says which release's variables count; Humble's without it.
inline fastdds::DomainParticipantQos from_environment() {
  auto qos = fastdds::PARTICIPANT_QOS_DEFAULT;
  const bool early = variable("ROS_DISTRO", "humble") <= "humble";
  if (early && variable("ROS_LOCALHOST_ONLY", "0") == "1") only_localhost(qos);
  if (!early && variable("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET") == "LOCALHOST") discover_localhost(qos);
  return qos;
}

// A participant that signs off when SIGINT or SIGTERM ends it. At most one a process.
class Node {
 public:
  Node() {
    sigemptyset(&ends_);
    sigaddset(&ends_, SIGINT);
    sigaddset(&ends_, SIGTERM);
    sigprocmask(SIG_BLOCK, &ends_, nullptr);  // before there are threads, which have it from us
    const auto domain = static_cast<std::uint32_t>(std::stoul(variable("ROS_DOMAIN_ID", "0")));
    participant = fastdds::DomainParticipantFactory::get_instance()->create_participant(domain, from_environment());
    if (participant == nullptr) throw std::runtime_error("no participant");
  }

  ~Node() {
    participant->delete_contained_entities();
    fastdds::DomainParticipantFactory::get_instance()->delete_participant(participant);
  }

  // A topic of ROS 2, /chatter, is DDS's rt/chatter.
  fastdds::Topic* topic(const std::string& name) {
    fastdds::TypeSupport type(new StringType);
    type.register_type(participant);
    return participant->create_topic("rt" + name, type.get_type_name(), fastdds::TOPIC_QOS_DEFAULT);
  }

  // Whether a condition came true within so many seconds, before the node was ended.
  template <typename Condition>
  bool within(double seconds, Condition holds) {
    const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    while (!holds()) {
      if (ended(0.002) || std::chrono::steady_clock::now() > until) return false;
    }
    return true;
  }

  // Until a signal ends it: a node stays.
  void stay() {
    while (!ended(3600)) {
    }
  }

  fastdds::DomainParticipant* participant;

 private:
  bool ended(double seconds) {
    const timespec time{static_cast<time_t>(seconds), static_cast<long>(seconds * 1e9) % 1000000000};
    if (!ended_) ended_ = sigtimedwait(&ends_, nullptr, &time) > 0;
    return ended_;
  }

  sigset_t ends_;
  bool ended_ = false;
};
