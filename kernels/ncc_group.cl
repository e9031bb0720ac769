// Denominators, coefficients and their maxima on a GPU; see ncc_common.cl. A work-group does a tile
// or a piece together: pixels and taps in local memory, one column of ROWS candidates per work-item,
// whose running products stay in registers.
// Options: GROUP_ROWS rows of work-items, each SCORED_W wide; PIECE_W = SCORED_W - 2 and
// PIECE_H = GROUP_ROWS * ROWS - 2, since a piece is scored with a rim of one candidate.
// Launch, one-dimensional, SCORED_W * GROUP_ROWS work-items per group: denominators: groups = tiles;
// pieces: groups = pieces.

#define SCORED_W (PIECE_W + 2)
#define SCORED_H (PIECE_H + 2)
#define GROUP_ROWS (SCORED_H / ROWS)
#define GROUP (SCORED_W * GROUP_ROWS)
#define PATCH_W (SCORED_W + TW - 1)
#define PATCH_H (SCORED_H + TH - 1)
#define ONE_GROUP __attribute__((reqd_work_group_size(GROUP, 1, 1)))
#define MAXIMA ((PIECE_W + 1) * (PIECE_H + 1) / 2)  // of a piece at most, of one row or of many

#if EXACT_BOX
typedef int box_t;
#else
typedef float box_t;
#endif

// Mean and 1 / standard deviation (0: none) of the footprints centred on the target's pixels; a
// tile has SCORED_W x SCORED_H of them, in the order of rows.
ONE_GROUP __kernel void denominators(__global const PIXEL* restrict target, int width, int height,
                                     int tiles_x, __global const int* restrict tiles, int count,
                                     __global float* restrict means,
                                     __global float* restrict inverses) {
  __local box_t patch[PATCH_H * PATCH_W];
  __local box_t sums[PATCH_H * SCORED_W], squares[PATCH_H * SCORED_W];
  const int lane = get_local_id(0), index = tiles[get_group_id(0)];
  const int x = HALF_W + (index % tiles_x) * SCORED_W, y = HALF_H + (index / tiles_x) * SCORED_H;
  __global const PIXEL* source = target + (size_t)(y - HALF_H) * width + x - HALF_W;
  const box_t origin = EXACT_BOX ? 0 : (box_t)pick_origin(source, width);
  for (int i = lane; i < PATCH_H * PATCH_W; i += GROUP) {
    const int r = i / PATCH_W, c = i % PATCH_W;
    const bool inside = y - HALF_H + r < height && x - HALF_W + c < width;
    patch[i] = inside ? (box_t)source[(size_t)r * width + c] - origin : 0;
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const int column = lane % SCORED_W, part = lane / SCORED_W;
  for (int r = part; r < PATCH_H; r += GROUP_ROWS) {
    box_t s = 0, s2 = 0;
    for (int u = 0; u < TW; ++u) {
      const box_t p = patch[r * PATCH_W + column + u];
#if EXACT_BOX
      s += p;
      s2 += p * p;
#else
      s += kWeightsX[u] * p;
      s2 += kWeightsX[u] * p * p;
#endif
    }
    sums[r * SCORED_W + column] = s;
    squares[r * SCORED_W + column] = s2;
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  for (int j = 0; j < ROWS; ++j) {
    const int row = part * ROWS + j;
    box_t s = 0, s2 = 0;
    for (int v = 0; v < TH; ++v) {
#if EXACT_BOX
      s += sums[(row + v) * SCORED_W + column];
      s2 += squares[(row + v) * SCORED_W + column];
#else
      s += kWeightsY[v] * sums[(row + v) * SCORED_W + column];
      s2 += kWeightsY[v] * squares[(row + v) * SCORED_W + column];
#endif
    }
    if (x + column >= width - HALF_W || y + row >= height - HALF_H) continue;
    const size_t at = (size_t)(y + row) * width + x + column;
#if EXACT_BOX
#if AREA * AREA * 255 * 255 / 65536 < 65536
    const float n2_variance = (float)((uint)AREA * (uint)s2 - (uint)s * (uint)s);
#else
    const float n2_variance = (float)((ulong)AREA * (ulong)s2 - (ulong)s * (ulong)s);
#endif
    means[at] = (float)s * (1.0f / (float)AREA);
    inverses[at] = n2_variance > 0.0f ? (float)AREA / sqrt(n2_variance) : 0.0f;
#else
    float variance = s2 - s * s;
    const float mean = s + origin;
    // Little variance far from the origin has lost its digits: once more, about the mean.
    if (variance < LOST_DIGITS * s * s && variance > -LEAST_DIGITS * s * s) {
      variance = 0.0f;
      for (int v = 0; v < TH; ++v)
        for (int u = 0; u < TW; ++u) {
          const float d = patch[(row + v) * PATCH_W + column + u] - s;
          variance += kWeightsY[v] * kWeightsX[u] * d * d;
        }
    }
#ifdef FLOAT_IMAGE
    const bool scored =
        variance > fmax(MIN_RELATIVE_VARIANCE * mean * mean, MIN_VARIANCE) && isfinite(variance);
#else
    const bool scored = variance >= MIN_WEIGHTED_VARIANCE;
#endif
    means[at] = mean;
    inverses[at] = scored ? 1.0f / sqrt(variance) : 0.0f;
#endif
  }
}

// As pieces() of ncc_score.cl.
ONE_GROUP __kernel void pieces(__global const PIXEL* restrict target, int target_width,
                               __global const Job* restrict jobs, __global const Piece* restrict list,
                               int count, __global const float* restrict stored,
                               __global const float* restrict means,
                               __global const float* restrict inverses, float quality,
                               int wants_map, __global float* restrict map,
                               __global Maxima* restrict maxima) {
  __local float patch[PATCH_H * PATCH_W];
  __local float taps[TH * TW];
  __local float scores[SCORED_H * SCORED_W];
  __local float bests[GROUP];
  __local int found[MAXIMA];  // places in scores
  __local int found_count;
  const int index = get_group_id(0), lane = get_local_id(0);
  const int column = lane % SCORED_W, part = lane / SCORED_W;
  const Piece piece = list[index];
  __global const Job* job = jobs + piece.job;
  __global const float* mine = stored + (size_t)piece.job * STORED;
  const float sum = mine[SUM_AT], factor = mine[FACTOR_AT];
  const int x0 = max(piece.x - 1, 0), y0 = max(piece.y - 1, 0);
  const int columns = min(piece.x + piece.width + 1, job->width) - x0;
  const int rows = min(piece.y + piece.height + 1, job->height) - y0;
  const int x = job->x + x0, y = job->y + y0;
  __global const PIXEL* source = target + (size_t)(y - HALF_H) * target_width + x - HALF_W;
  const float origin = pick_origin(source, target_width);
  for (int i = lane; i < PATCH_H * PATCH_W; i += GROUP) {
    const int r = i / PATCH_W, c = i % PATCH_W;
    patch[i] = r < rows + TH - 1 && c < columns + TW - 1
                   ? (float)source[(size_t)r * target_width + c] - origin
                   : 0.0f;
  }
  for (int i = lane; i < TH * TW; i += GROUP) taps[i] = mine[TAPS_AT + i];
  if (lane == 0) found_count = 0;
  barrier(CLK_LOCAL_MEM_FENCE);

  float acc[ROWS];
#pragma unroll
  for (int j = 0; j < ROWS; ++j) acc[j] = 0.0f;
  for (int u = 0; u < TW; ++u) {
    __local const float* p = patch + part * ROWS * PATCH_W + column + u;
    float tap[ROWS];  // of rows r, r - 1, ...
#pragma unroll
    for (int j = 0; j < ROWS; ++j) tap[j] = 0.0f;
#pragma unroll
    for (int r = 0; r < TH + ROWS - 1; ++r) {
#pragma unroll
      for (int j = ROWS - 1; j > 0; --j) tap[j] = tap[j - 1];
      if (r < TH) tap[0] = taps[r * TW + u];
      const float s = p[r * PATCH_W];
#pragma unroll
      for (int j = 0; j < ROWS; ++j)
        if (r - j >= 0 && r - j < TH) acc[j] = fma(s, tap[j], acc[j]);
    }
  }
#pragma unroll
  for (int j = 0; j < ROWS; ++j) {
    const int row = part * ROWS + j;
    float c = NO_SCORE;
    if (row < rows && column < columns && !isnan(sum)) {
      const size_t at = (size_t)(y + row) * target_width + x + column;
      const float inverse = inverses[at];
      const float value = fma(-sum, means[at] - origin, acc[j]) * (factor * inverse);
      if (inverse > 0.0f && value == value) c = clamp(value, -1.0f, 1.0f);
    }
    scores[row * SCORED_W + column] = c;
  }
  barrier(CLK_LOCAL_MEM_FENCE);

  // This work-item's column of the piece itself.
  const int left = piece.x - x0, top = piece.y - y0;
  const bool mine_column = column >= left && column < left + piece.width;
  float best = NO_SCORE;
  if (mine_column)
    for (int row = max(part * ROWS, top); row < min(part * ROWS + ROWS, top + piece.height); ++row) {
      const float c = scores[row * SCORED_W + column];
      best = fmax(best, c);
      if (wants_map)
        map[(size_t)(piece.y + row - top) * job->width + piece.x + column - left] = c;
    }
  if (wants_map) return;
  bests[lane] = best;
  for (int step = GROUP / 2; step > 0; step /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane < step) bests[lane] = fmax(bests[lane], bests[lane + step]);
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  best = bests[0];
  const float threshold = peak_threshold(quality, best);
  // A maximum has all its neighbours in the window.
  const int reach_x = (job->flat & 2) != 0 ? 0 : 1, reach_y = (job->flat & 1) != 0 ? 0 : 1;
  const int job_x = x0 + column;
  if (mine_column && (reach_x != 0 || reach_y != 0) && job_x >= reach_x &&
      job_x < job->width - reach_x)
    for (int row = max(part * ROWS, top); row < min(part * ROWS + ROWS, top + piece.height); ++row) {
      if (y0 + row < reach_y || y0 + row >= job->height - reach_y) continue;
      __local const float* p = scores + row * SCORED_W + column;
      bool maximum = p[0] >= threshold;
      for (int j = -reach_y; j <= reach_y && maximum; ++j)
        for (int i = -reach_x; i <= reach_x; ++i) {
          const float n = p[j * SCORED_W + i];
          if (i != 0 || j != 0) maximum = maximum && p[0] > n && n > NO_SCORE;
        }
      if (maximum) found[atomic_inc(&found_count)] = row * SCORED_W + column;
    }
  barrier(CLK_LOCAL_MEM_FENCE);
  if (lane != 0) return;

  float value[MAX_PEAKS];
  int place[MAX_PEAKS], from[MAX_PEAKS];
  int kept = 0;
  for (int i = 0; i < found_count; ++i) {  // in any order: keep_best() is the judge
    const int at = found[i];
    kept = keep_best(value, place, from, kept, scores[at],
                     (y0 + at / SCORED_W) * job->width + x0 + at % SCORED_W, at);
  }
  __global Maxima* out = maxima + index;
  out->best = best;
  out->count = kept;
  for (int k = 0; k < kept; ++k) {
    out->place[k] = place[k];
    for (int j = -1; j <= 1; ++j)
      for (int i = -1; i <= 1; ++i)
        out->around[k][3 * (j + 1) + i + 1] =
            abs(i) <= reach_x && abs(j) <= reach_y ? scores[from[k] + j * SCORED_W + i] : NO_SCORE;
  }
}
