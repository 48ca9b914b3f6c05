// dds_talker TOPIC SECONDS: sends 50 messages as soon as somebody listens, or when the seconds are over, and says how
// many a listener has acknowledged.
#include <cstdio>

#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>

#include "node.hpp"

int main(int count, char** words) {
  if (count != 3) return 2;
  const double seconds = std::stod(words[2]);
  Node node;
  auto* publisher = node.participant->create_publisher(fastdds::PUBLISHER_QOS_DEFAULT);
  auto qos = fastdds::DATAWRITER_QOS_DEFAULT;
  qos.reliability().kind = fastdds::RELIABLE_RELIABILITY_QOS;
  qos.history().kind = fastdds::KEEP_ALL_HISTORY_QOS;
  qos.data_sharing().off();  // as rmw_fastrtps has it
  auto* writer = publisher->create_datawriter(node.topic(words[1]), qos);
  const auto listened = [writer] {
    fastdds::PublicationMatchedStatus status;
    writer->get_publication_matched_status(status);
    return status.current_count > 0;
  };
  const bool matched = node.within(seconds, listened);
  for (int number = 0; number < MESSAGES; ++number) {
    std::string text = "message " + std::to_string(number);
    writer->write(&text);
    node.within(0.005, [] { return false; });
  }
  const bool acknowledged = matched && writer->wait_for_acknowledgments({static_cast<int>(seconds), 0}) ==
                                           eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK;
  std::printf("sent %d: %s, %s\n", MESSAGES, matched ? "matched" : "nobody listens",
              acknowledged ? "acknowledged" : "not acknowledged");
  std::fflush(stdout);
  node.stay();
}
