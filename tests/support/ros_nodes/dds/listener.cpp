// dds_listener TOPIC SECONDS: waits for 50 messages, or until the seconds are over, and says how many came.
#include <cstdio>

#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include "node.hpp"

int main(int count, char** words) {
  if (count != 3) return 2;
  Node node;
  auto* subscriber = node.participant->create_subscriber(fastdds::SUBSCRIBER_QOS_DEFAULT);
  auto qos = fastdds::DATAREADER_QOS_DEFAULT;
  qos.reliability().kind = fastdds::RELIABLE_RELIABILITY_QOS;
  qos.history().kind = fastdds::KEEP_ALL_HISTORY_QOS;
  qos.data_sharing().off();  // as rmw_fastrtps has it
  auto* reader = subscriber->create_datareader(node.topic(words[1]), qos);
  int received = 0;
  node.within(std::stod(words[2]), [&] {
    std::string text;
    fastdds::SampleInfo info;
    while (reader->take_next_sample(&text, &info) == eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK)
      received += info.valid_data ? 1 : 0;
    return received >= MESSAGES;
  });
  fastdds::SubscriptionMatchedStatus status;
  reader->get_subscription_matched_status(status);
  std::printf("received %d of %d: %s\n", received, MESSAGES, status.total_count > 0 ? "matched" : "nobody talks");
  std::fflush(stdout);
  node.stay();
}
