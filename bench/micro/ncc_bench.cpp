// `corvid bench ncc` without the rest of the program, for work on the kernels: it builds without
// the engine. All tables; ncc_bench [DEVICE [FILE.json]].
#include <iostream>

#include "bench/ncc_bench.h"
#include "io/atomic_file.h"

int main(int argc, char** argv) {
  using namespace corvid;
  const auto failed = [](const Error& error) {
    std::cerr << "error: " << error.to_string() << "\n";
    return 1;
  };
  const auto device = Device::open(argc > 1 ? argv[1] : "auto");
  if (!device) return failed(device.error());
  NccReport report;
  const auto done = run_ncc_bench(*device, {}, {}, report);
  print(report, std::cout);
  if (!done) return failed(done.error());
  if (argc > 2) {
    if (auto written = write_file_atomically(argv[2], json_rows(report)); !written)
      return failed(written.error());
  }
  const auto wrong = disagreements(report);
  for (const std::string& sentence : wrong) std::cerr << "error: " << sentence << "\n";
  return wrong.empty() ? 0 : 1;
}
