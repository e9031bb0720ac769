#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <string>

namespace corvid {

struct DeviceInfo;

/// Which of several ways of computing the same thing is fastest on one device: measured once, kept
/// in cache_folder()/tuning, one JSON file per device. A file that is damaged, of another format or
/// of another state of the device (driver, platform, compute units) is ignored and written again,
/// as is a choice that was measured with other sources. A folder that cannot be written is logged
/// once; choices then last as long as the process. Of two processes that write at a time one may
/// lose its choice, to be measured again.
///
/// With CORVID_TUNING=off in the environment when the device is opened nothing is measured, read or
/// written: the first candidate is always taken. Thread-safe.
class Tuning {
 public:
  struct Candidate {
    std::string name;
    std::function<void()> run;  ///< does the work once and waits for it; may throw DeviceFault
  };

  /// In cache_folder()/tuning.
  explicit Tuning(const DeviceInfo& device);
  /// For tests. @param folder  empty: nothing is read or written. @param now_ns  a clock.
  Tuning(const DeviceInfo& device, std::filesystem::path folder,
         std::function<std::int64_t()> now_ns);

  /// What is kept under `key`, measured with these sources (see program_id()).
  [[nodiscard]] std::optional<std::string> choice(const std::string& key,
                                                  const std::string& sources);
  /// Keeps it, in the file too. @param measured_ms  by candidate, for whoever reads the file.
  void keep(const std::string& key, const std::string& sources, const std::string& choice,
            const std::map<std::string, double>& measured_ms);
  /// The kept choice if it is one of the candidates. Else each is run once to warm up, then all in
  /// turns, up to 7 times or until 0.3 s have passed; that with the smallest median is kept and
  /// returned, among equals the first. A candidate that throws DeviceFault is left out; if all do,
  /// the first is returned and nothing is kept. One measurement at a time: candidates must not call
  /// choose(). At least one candidate.
  [[nodiscard]] std::string choose(const std::string& key, const std::string& sources,
                                   std::span<const Candidate> candidates);

  [[nodiscard]] bool enabled() const { return enabled_; }
  /// Where choices are kept; empty if they are not.
  [[nodiscard]] const std::filesystem::path& file() const { return file_; }

 private:
  struct Entry {
    std::string sources, choice;
    std::map<std::string, double> measured_ms;
  };
  using Entries = std::map<std::string, Entry>;

  [[nodiscard]] Entries read() const;
  void write(const Entries& entries);

  std::map<std::string, std::string> device_;  // what a file must have been made for
  std::filesystem::path file_;
  std::function<std::int64_t()> now_ns_;
  bool enabled_;
  std::mutex measuring_;  // held while candidates run, and then mutex_
  std::mutex mutex_;
  bool loaded_ = false, complained_ = false;
  Entries entries_;
};

}  // namespace corvid
