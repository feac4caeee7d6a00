/* Copyright 2026 The hyst_control authors */
/* SPDX-License-Identifier: Apache-2.0 */
/* Drives the generated controller as a controller manager does, and prints what a test compares. */
#include "controller.cpp"

#include <cstdlib>
#include <new>

#include "loop_golden.h"

using controller_interface::CallbackReturn;
static long allocations = 0;

__attribute__((noinline)) void * operator new(std::size_t size)
{
  allocations++;
  if (void * place = std::malloc(size)) return place;
  throw std::bad_alloc();
}
__attribute__((noinline)) void operator delete(void * place) noexcept { std::free(place); }
__attribute__((noinline)) void operator delete(void * place, std::size_t) noexcept { std::free(place); }

constexpr std::size_t AXES = loop_controller::AXES;
constexpr double NOTHING = std::numeric_limits<double>::quiet_NaN();

/* A controller whose hardware is two arrays. */
struct Rig
{
  std::unique_ptr<controller_interface::ChainableControllerInterface> made = make_controller();
  std::array<double, AXES> volts, position{};
  std::vector<hardware_interface::CommandInterface> references;
  std::vector<hardware_interface::StateInterface> states;
  std_msgs::msg::Float64MultiArray message;

  explicit Rig(double applied, unsigned int rate = RATE)
  {
    volts.fill(applied);
    made->update_rate = rate;
    made->on_init();
    if (made->on_configure({}) != CallbackReturn::SUCCESS) return;
    references = made->references();
    states = made->states();
    for (std::size_t i = 0; i < AXES; i++) {
      made->command_interfaces_.emplace_back("axis", "voltage", &volts[i]);
      made->state_interfaces_.emplace_back("axis", "position", &position[i]);
    }
    made->on_activate({});
    message.data.resize(AXES + 1);
  }

  template <typename M> void send(const std::string & topic, const M & sent)
  {
    std::any_cast<typename rclcpp::Subscription<M>::SharedPtr>(made->node->subscriptions.at(topic))->call(sent);
  }

  void refer(const double * row)
  {
    std::copy(row, row + AXES, message.data.begin() + 1);
    send("~/reference", message);
  }

  double fault() const { return *states.at(0).place; }
};

static void golden()
{
  Rig rig(NOTHING);
  long wrong = 0, within = 0;
  for (int row = 1; row < ROWS; row++) {
    const double * in = golden_in[row];
    rig.refer(in);
    rig.send("~/enable", std_msgs::msg::Bool{in[2 * AXES] > 0.5});
    std::copy(in + AXES, in + 2 * AXES, rig.position.begin());
    const long before = allocations;
    rig.made->update({}, {});
    within += allocations - before;
    for (std::size_t i = 0; i < AXES; i++) wrong += rig.volts[i] != golden_out[row][i];
    wrong += rig.fault() != golden_out[row][3 * AXES];
  }
  std::printf("golden %d wrong %ld allocations %ld\n", ROWS - 1, wrong, within);
}

/* Taken over at 12 V: held until the first reference, then without a jump; without further references a fault, and the safe command. */
static void taken_over()
{
  Rig rig(12.0);
  for (int tick = 0; tick < 10; tick++) rig.made->update({}, {});
  std::printf("held %.17g\n", rig.volts[0]);
  const std::array<double, AXES> middle{};
  rig.refer(middle.data());
  rig.made->update({}, {});
  std::printf("first %.17g\n", rig.volts[0]);
  for (int tick = 0; tick < 2 * RATE; tick++) {
    rig.position[0] = 1e-3 * std::sin(0.1 * tick);
    rig.made->update({}, {});
  }
  std::printf("silent fault %g command %.17g\n", rig.fault(), rig.volts[0]);
}

/* In a chain the reference interfaces are what counts. */
static void chained()
{
  Rig rig(0.0);
  rig.made->chained = true;
  for (int tick = 0; tick < RATE; tick++) {
    for (auto & reference : rig.references) std::ignore = reference.set_value(1.0);
    rig.position.fill(0.5 + 1e-3 * std::sin(0.1 * tick));
    rig.made->update({}, {});
  }
  std::printf("chained fault %g command %.17g name %s/%s\n", rig.fault(), rig.volts[0], rig.references[0].prefix.c_str(),
              rig.references[0].interface.c_str());
}

int main()
{
  golden();
  taken_over();
  chained();
  Rig refused(0.0, RATE + 100);
}
