#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace corvid::vm {

/// The program corvid as the host has built it, running beside the test. Its talk goes to the
/// test's standard error. Killed if it still runs at the end of this object's life.
class CorvidProgram {
 public:
  explicit CorvidProgram(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "corvid");
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    std::array<int, 2> output{};
    if (::pipe2(output.data(), O_CLOEXEC) != 0) return;
    child_ = ::fork();
    if (child_ == 0) {
      ::dup2(output[1], STDOUT_FILENO);
      ::execv(CORVID_PROGRAM, argv.data());
      ::_exit(127);
    }
    ::close(output[1]);
    output_ = ::fdopen(output[0], "r");
  }
  CorvidProgram(const CorvidProgram&) = delete;
  CorvidProgram& operator=(const CorvidProgram&) = delete;
  ~CorvidProgram() {
    if (child_ > 0) {
      signal(SIGKILL);
      exit_code();
    }
    std::fclose(output_);
  }

  void signal(int number) const { ::kill(child_, number); }

  /// The next line of its standard output; nothing at the end. Waits as long as the guest lives.
  std::optional<std::string> line() {
    std::string line;
    for (int c; (c = std::fgetc(output_)) != EOF && c != '\n';) line += static_cast<char>(c);
    if (line.empty() && std::feof(output_) != 0) return std::nullopt;
    return line;
  }
  /// All that is left of its standard output.
  std::string rest() {
    std::string all;
    while (auto one = line()) all += *one + "\n";
    return all;
  }

  /// The next event of `--json` with this name that `fits`; with a failed test, null if it ends
  /// before.
  nlohmann::json event(
      const std::string& name,
      const std::function<bool(const nlohmann::json&)>& fits = [](const auto&) { return true; }) {
    while (auto one = line()) {
      auto json = nlohmann::json::parse(*one, nullptr, false);
      if (json.is_object() && json.value("event", "") == name && fits(json)) return json;
    }
    ADD_FAILURE() << "the program ended without the event " << name;
    return nullptr;
  }

  /// Waits for its end; -1 if a signal killed it.
  int exit_code() {
    int status = 0;
    if (::waitpid(std::exchange(child_, 0), &status, 0) < 0 || !WIFEXITED(status)) return -1;
    return WEXITSTATUS(status);
  }

 private:
  pid_t child_ = 0;
  std::FILE* output_ = nullptr;
};

}  // namespace corvid::vm
