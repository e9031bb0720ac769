#include "kernels/tuning.h"

#include <fmt/core.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string_view>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/log.h"
#include "kernels/cache_file.h"
#include "kernels/device.h"
#include "kernels/vendor_files.h"

namespace corvid {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

constexpr std::string_view kFormat = "corvid tuning 1";
constexpr int kRuns = 7;
constexpr std::int64_t kBudget_ns = 300'000'000;

bool is_off() {
  const char* value = std::getenv("CORVID_TUNING");
  return value != nullptr && std::string_view(value) == "off";
}

fs::path default_folder() {
  const fs::path cache = cache_folder();
  return cache.empty() ? fs::path() : cache / "tuning";
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 != 0 ? values[half] : (values[half - 1] + values[half]) / 2;
}

}  // namespace

Tuning::Tuning(const DeviceInfo& device)
    : Tuning(device, default_folder(), [] {
        return std::chrono::duration_cast<std::chrono::nanoseconds>(
                   std::chrono::steady_clock::now().time_since_epoch())
            .count();
      }) {}

Tuning::Tuning(const DeviceInfo& device, fs::path folder, std::function<std::int64_t()> now_ns)
    : device_{{"format", std::string(kFormat)},
              {"device", device.name},
              {"platform", device.platform},
              {"driver", device.version},
              {"compute_units", std::to_string(device.compute_units)}},
      now_ns_(std::move(now_ns)),
      enabled_(!is_off()) {
  if (enabled_ && !folder.empty())
    file_ = folder / fmt::format("{:016x}.json", fnv1a(device.platform + '\n' + device.name));
}

Tuning::Entries Tuning::read() const {
  if (file_.empty()) return {};
  const auto bytes = read_cache_file(file_);
  if (!bytes) return {};
  try {
    const json file = json::parse(*bytes);
    for (const auto& [name, value] : device_)
      if (file.at(name).get<std::string>() != value) {
        log().info("{}: made for another {}, ignored", file_.string(), name);
        return {};
      }
    Entries entries;
    for (const auto& [key, value] : file.at("choices").items())
      entries[key] = {value.at("sources").get<std::string>(), value.at("choice").get<std::string>(),
                      value.at("measured_ms").get<std::map<std::string, double>>()};
    return entries;
  } catch (const json::exception& e) {
    log().warn("{}: not a tuning file, ignored ({})", file_.string(), e.what());
    return {};
  }
}

void Tuning::write(const Entries& entries) {
  if (file_.empty()) return;
  json file = device_;
  file["choices"] = json::object();
  for (const auto& [key, entry] : entries)
    file["choices"][key] = {
        {"sources", entry.sources}, {"choice", entry.choice}, {"measured_ms", entry.measured_ms}};
  const std::string text = file.dump(2, ' ', false, json::error_handler_t::replace) + '\n';
  const auto error = write_cache_file(file_, text);
  if (!error || complained_) return;
  complained_ = true;
  log().warn("{}: choices cannot be kept ({})", file_.string(), error.message());
}

std::optional<std::string> Tuning::choice(const std::string& key, const std::string& sources) {
  if (!enabled_) return std::nullopt;
  const std::lock_guard lock(mutex_);
  if (!std::exchange(loaded_, true)) entries_ = read();
  const auto found = entries_.find(key);
  if (found == entries_.end() || found->second.sources != sources) return std::nullopt;
  return found->second.choice;
}

void Tuning::keep(const std::string& key, const std::string& sources, const std::string& choice,
                  const std::map<std::string, double>& measured_ms) {
  if (!enabled_) return;
  const std::lock_guard lock(mutex_);
  loaded_ = true;
  entries_[key] = {sources, choice, measured_ms};
  // What other processes kept meanwhile stays in the file, and what this one knows stays as it is.
  entries_.merge(read());
  write(entries_);
}

std::string Tuning::choose(const std::string& key, const std::string& sources,
                           std::span<const Candidate> candidates) {
  CORVID_CHECK(!candidates.empty(), "there is something to choose from");
  if (!enabled_) return candidates[0].name;
  const auto kept = [&]() -> std::optional<std::string> {
    auto name = choice(key, sources);
    if (name && std::any_of(candidates.begin(), candidates.end(),
                            [&](const Candidate& c) { return c.name == *name; }))
      return name;
    return std::nullopt;
  };
  if (auto name = kept()) return *name;
  const std::lock_guard lock(measuring_);
  if (auto name = kept()) return *name;  // measured by another thread meanwhile

  log().info("tuning {}: measuring", key);
  struct Timed {
    const Candidate* candidate;
    std::vector<double> ms;
  };
  std::vector<Timed> timed;
  // Milliseconds, or nothing if the device refused.
  const auto run = [&](const Candidate& candidate) -> std::optional<double> {
    try {
      const std::int64_t start = now_ns_();
      candidate.run();
      return static_cast<double>(now_ns_() - start) * 1e-6;
    } catch (const DeviceFault& e) {
      log().warn("tuning {}: {} left out ({})", key, candidate.name, e.what());
      return std::nullopt;
    }
  };
  for (const Candidate& candidate : candidates)  // drivers compile at the first run
    if (run(candidate)) timed.push_back({&candidate, {}});
  const std::int64_t start = now_ns_();
  for (int i = 0; i < kRuns && timed.size() > 1; ++i) {
    if (i > 0 && now_ns_() - start > kBudget_ns) break;
    std::erase_if(timed, [&](Timed& t) {
      const auto ms = run(*t.candidate);
      if (ms) t.ms.push_back(*ms);
      return !ms;
    });
  }
  if (timed.empty()) return candidates[0].name;
  std::map<std::string, double> medians;
  const Timed* best = nullptr;
  for (const Timed& t : timed) {
    if (t.ms.empty()) {  // the only one that runs
      best = &t;
      continue;
    }
    const double ms = medians[t.candidate->name] = median(t.ms);
    log().info("tuning {}: {} {:.3f} ms", key, t.candidate->name, ms);
    if (best == nullptr || ms < medians[best->candidate->name]) best = &t;
  }
  keep(key, sources, best->candidate->name, medians);
  return best->candidate->name;
}

}  // namespace corvid
