#pragma once

#include <functional>

namespace corvid {

/// Calls work(first, last) for bands of `band` rows that cover [0, rows), on `threads` threads
/// (0: one per core) of which the caller is one; returns when all is done. The first exception
/// of a band is thrown again here.
void parallel_rows(int rows, int band, int threads, const std::function<void(int, int)>& work);

}  // namespace corvid
