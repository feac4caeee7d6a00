// Copyright 2026 The hyst_control authors
// SPDX-License-Identifier: Apache-2.0
// Made by hyst export.
// Chainable controller of ros2_control around {{ name }}_step. update_and_write_commands allocates no memory and never blocks.
#include "{{ name }}.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <limits>
#include <mutex>
#include <string>
#include <tuple>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/bool.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

namespace {{ name }}_controller
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

constexpr std::size_t AXES = {{ axes | length }};
constexpr double NOTHING = std::numeric_limits<double>::quiet_NaN();
const std::array<const char *, AXES> AXIS = { {%- for axis in axes %}"{{ axis }}"{{ ", " if not loop.last }}{% endfor -%} };

class Controller : public controller_interface::ChainableControllerInterface
{
public:
  CallbackReturn on_init() override
  {
    std::vector<std::string> commands, states;
    for (const std::string axis : AXIS) {
      commands.push_back(axis + "/voltage");
      states.push_back(axis + "/position");
    }
    auto_declare<std::vector<std::string>>("command_interfaces", commands);
    auto_declare<std::vector<std::string>>("state_interfaces", states);
    auto_declare<double>("scale", 1.0);
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    commands_ = get_node()->get_parameter("command_interfaces").as_string_array();
    states_ = get_node()->get_parameter("state_interfaces").as_string_array();
    scale_ = get_node()->get_parameter("scale").as_double();
    if (commands_.size() != AXES || states_.size() != AXES) {
      return refused("command_interfaces and state_interfaces: give {{ axes | length }} of each");
    }
    if (!std::isfinite(scale_) || scale_ == 0.0) {
      return refused("scale: must be finite and not 0");
    }
    if (std::abs(get_update_rate() * {{ upper }}_SAMPLE_TIME - 1.0) > 1e-3) {
      return refused("update_rate: the controller was exported for {{ rate }} Hz: set that, or export it again");
    }
    reference_ = get_node()->create_subscription<std_msgs::msg::Float64MultiArray>(
      "~/reference", rclcpp::SystemDefaultsQoS(), [this](const std_msgs::msg::Float64MultiArray & message) {
        if (message.data.size() >= AXES) {  // the newest row, with a time before it or without
          const std::lock_guard<std::mutex> lock(mutex_);
          std::copy(message.data.end() - static_cast<std::ptrdiff_t>(AXES), message.data.end(), received_.begin());
        }
      });
    enable_ = get_node()->create_subscription<std_msgs::msg::Bool>(
      "~/enable", rclcpp::SystemDefaultsQoS(), [this](const std_msgs::msg::Bool & message) { enabled_ = message.data; });
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override
  {
    return {interface_configuration_type::INDIVIDUAL, commands_};
  }

  InterfaceConfiguration state_interface_configuration() const override
  {
    return {interface_configuration_type::INDIVIDUAL, states_};
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    {{ name }}_init(&state_);
    for (std::size_t i = 0; i < AXES; i++) {
      const double applied = command_interfaces_[i].get_optional().value_or(NOTHING);
      if (std::isfinite(applied)) {  // it goes on from there without a jump
        state_.chain.command[i] = static_cast<{{ name }}_real>(applied);
        state_.chain.away[i] = 1;
      }
    }
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      received_.fill(NOTHING);
    }
    reference_interfaces_.assign(AXES, NOTHING);
    enabled_ = true;
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    return CallbackReturn::SUCCESS;  // the hardware keeps the last command
  }

protected:
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override
  {
    reference_interfaces_.assign(AXES, NOTHING);
    std::vector<hardware_interface::CommandInterface> found;
    for (std::size_t i = 0; i < AXES; i++) {
      found.emplace_back(std::string(get_node()->get_name()) + "/" + AXIS[i], "position", &reference_interfaces_[i]);
    }
    return found;
  }

  std::vector<hardware_interface::StateInterface> on_export_state_interfaces() override
  {
    std::vector<hardware_interface::StateInterface> found;
    found.emplace_back(get_node()->get_name(), "fault", &fault_);
    return found;
  }

  return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
    reference_interfaces_.assign(AXES, NOTHING);  // a reference that stays away is a fault after the timeout
    if (lock) {
      std::copy(received_.begin(), received_.end(), reference_interfaces_.begin());
      received_.fill(NOTHING);
    }
    return return_type::OK;
  }

  return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    {{ name }}_real in[{{ upper }}_INPUTS], out[{{ upper }}_OUTPUTS];
    for (std::size_t i = 0; i < AXES; i++) {
      in[i] = static_cast<{{ name }}_real>(scale_ * reference_interfaces_[i]);
      in[AXES + i] = static_cast<{{ name }}_real>(scale_ * state_interfaces_[i].get_optional().value_or(NOTHING));
    }
    in[{{ upper }}_IN_ENABLE] = enabled_ ? 1 : 0;
    {{ name }}_step(&state_, in, out);
    for (std::size_t i = 0; i < AXES; i++) {
      std::ignore = command_interfaces_[i].set_value(static_cast<double>(out[i]));
    }
    fault_ = static_cast<double>(out[{{ upper }}_OUT_FAULT]);
    return return_type::OK;
  }

private:
  CallbackReturn refused(const char * reason)
  {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", reason);
    return CallbackReturn::ERROR;
  }

  {{ name }}_state state_{};
  std::vector<std::string> commands_, states_;
  double scale_ = 1.0, fault_ = 0.0;
  std::mutex mutex_;
  std::array<double, AXES> received_{};
  std::atomic<bool> enabled_{true};
  rclcpp::Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr reference_;
  rclcpp::Subscription<std_msgs::msg::Bool>::SharedPtr enable_;
};
}  // namespace {{ name }}_controller

PLUGINLIB_EXPORT_CLASS({{ name }}_controller::Controller, controller_interface::ChainableControllerInterface)
