// The part of BehaviorTree.CPP's interface (version 4) that the leaves of docs/how-to/behavior-trees.md use, for
// machines that do not have the library: signatures as in its headers, without its tree.
#pragma once
#include <map>
#include <optional>
#include <string>

namespace BT {
enum class NodeStatus { IDLE, RUNNING, SUCCESS, FAILURE, SKIPPED };

struct PortInfo {};
using PortsList = std::map<std::string, PortInfo>;
template <typename T> std::pair<std::string, PortInfo> InputPort(const std::string& name) { return {name, {}}; }

struct NodeConfig {
  std::map<std::string, std::string> input_ports;
};

class StatefulActionNode {
 public:
  StatefulActionNode(const std::string& name, const NodeConfig& config) : name_(name), config_(config) {}
  virtual ~StatefulActionNode() = default;
  virtual NodeStatus onStart() = 0;
  virtual NodeStatus onRunning() = 0;
  virtual void onHalted() = 0;

  NodeStatus executeTick() {
    status_ = status_ == NodeStatus::RUNNING ? onRunning() : onStart();
    return status_;
  }

  void haltNode() {
    if (status_ == NodeStatus::RUNNING) onHalted();
    status_ = NodeStatus::IDLE;
  }

 protected:
  // The library's is nonstd::expected, which also has value().
  template <typename T> std::optional<T> getInput(const std::string& key) const { return config_.input_ports.at(key); }

 private:
  std::string name_;
  NodeConfig config_;
  NodeStatus status_ = NodeStatus::IDLE;
};
}  // namespace BT
