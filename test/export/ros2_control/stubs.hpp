/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* As much of ros2_control and rclcpp as the generated controller uses, with their signatures: a parameter and a message are what a test sets. */
#pragma once
#include <any>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__))
#define PLUGINLIB_EXPORT_CLASS(made, base) \
  std::unique_ptr<base> make_controller() { return std::make_unique<made>(); }

namespace std_msgs::msg
{
struct Bool { bool data = false; };
struct Float64MultiArray { std::vector<double> data; };
}

namespace rclcpp
{
struct Time {};
struct Duration {};
struct Logger {};
struct SystemDefaultsQoS {};
template <typename M> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; std::function<void(const M &)> call; };
struct Parameter
{
  std::any value;
  double as_double() const { return std::any_cast<double>(value); }
  std::vector<std::string> as_string_array() const { return std::any_cast<std::vector<std::string>>(value); }
};
}

namespace rclcpp_lifecycle
{
struct State {};
struct LifecycleNode
{
  std::map<std::string, std::any> parameters, subscriptions;
  rclcpp::Parameter get_parameter(const std::string & name) const { return {parameters.at(name)}; }
  rclcpp::Logger get_logger() const { return {}; }
  const char * get_name() const { return "loop"; }
  template <typename M, typename C>
  typename rclcpp::Subscription<M>::SharedPtr create_subscription(const std::string & topic, rclcpp::SystemDefaultsQoS, C call)
  {
    auto made = std::make_shared<rclcpp::Subscription<M>>();
    made->call = call;
    subscriptions[topic] = made;
    return made;
  }
};
}

namespace hardware_interface
{
struct Handle
{
  std::string prefix, interface;
  double * place;
  Handle(const std::string & prefix_name, const std::string & interface_name, double * value)
  : prefix(prefix_name), interface(interface_name), place(value) {}
  template <typename T = double> [[nodiscard]] std::optional<T> get_optional() const { return *place; }
  template <typename T> [[nodiscard]] bool set_value(const T & value) { *place = value; return true; }
};
using CommandInterface = Handle;
using StateInterface = Handle;
}

namespace controller_interface
{
enum class CallbackReturn : std::uint8_t { SUCCESS, FAILURE, ERROR };
enum class return_type : std::uint8_t { OK, ERROR };
enum class interface_configuration_type : std::uint8_t { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration { interface_configuration_type type; std::vector<std::string> names = {}; };

class ChainableControllerInterface
{
public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node; }
  unsigned int get_update_rate() const { return update_rate; }
  template <typename T> T auto_declare(const std::string & name, const T & value)
  {
    return std::any_cast<T>(node->parameters.emplace(name, value).first->second);
  }
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    if (!chained) update_reference_from_subscribers(time, period);
    return update_and_write_commands(time, period);
  }
  std::vector<hardware_interface::CommandInterface> references() { return on_export_reference_interfaces(); }
  std::vector<hardware_interface::StateInterface> states() { return on_export_state_interfaces(); }

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
  unsigned int update_rate = 0;
  bool chained = false;
  std::vector<hardware_interface::CommandInterface> command_interfaces_;
  std::vector<hardware_interface::StateInterface> state_interfaces_;

protected:
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
  virtual std::vector<hardware_interface::StateInterface> on_export_state_interfaces() = 0;
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  std::vector<double> reference_interfaces_;
};
}
