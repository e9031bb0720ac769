// Denominators, coefficients and their maxima on a CPU; see ncc_common.cl. A work-item does a piece:
// a strip whose coefficients stay in its core's cache.
// Launch, one-dimensional: denominators: x >= tiles; pieces: x >= pieces.

// 1 / sqrt(v), where v > 0 and normal, to 2e-7.
inline floatv inverse_root(floatv v) {
#if defined(__AVX512F__) && LANES == 16
  // The estimate of 14 bits and a step of Newton's: a third of the time of root and division.
  const floatv y = __builtin_ia32_rsqrt14ps512_mask(v, (floatv)(0), (ushort)0xffff);
  return y * fma(-0.5f * v * y, y, (floatv)(1.5f));
#else
  return 1.0f / sqrt(v);
#endif
}

// Rows of a tile of the denominators, and columns.
#define BOX_ROWS 32
#define BOX_COLUMNS (2 * LANES)

#if EXACT_BOX
// Sums over the footprints of candidates from sums over the rows of footprints; even candidates in
// [0], odd in [1].
#define LAST_PAIR ((TW & 1) != 0 ? 0x0000ffff : (int)0xffffffff)

typedef struct {
  intv s[2], squares[2];
} RowSums;

// Of one row of 16-bit pixels.
inline RowSums row_sums(const short* p) {
  RowSums sums;
#pragma unroll
  for (int o = 0; o < 2; ++o) {
    intv s = 0, squares = 0;
#pragma unroll
    for (int g = 0; g < PAIRS_X; ++g) {
      const int mask = g == PAIRS_X - 1 ? LAST_PAIR : (int)0xffffffff;
      const intv pixels = LOAD_PAIRS(p + 2 * g + o) & mask;
      s += MULTIPLY_PAIRS(pixels, (intv)(0x00010001));
      squares += MULTIPLY_PAIRS(pixels, pixels);
    }
    sums.s[o] = s;
    sums.squares[o] = squares;
  }
  return sums;
}

// Mean, and 1 / standard deviation or 0 if there is none, from the sums over footprints.
inline void box_denominators(intv sum, intv squares, floatv* mean, floatv* inverse) {
#if AREA * AREA * 255 * 255 / 65536 < 65536
  const floatv n2_variance = TO_FLOAT((uint)AREA * TO_UINT(squares) - TO_UINT(sum) * TO_UINT(sum));
#else
  const floatv n2_variance =
      TO_FLOAT((ulong)AREA * TO_ULONG(squares) - TO_ULONG(sum) * TO_ULONG(sum));
#endif
  *mean = TO_FLOAT(sum) * (1.0f / (float)AREA);
  *inverse = select((floatv)(0), (float)AREA * inverse_root(n2_variance), n2_variance > 0.0f);
}
#endif

// C of candidates that have a variance, NO_SCORE of the others and from `limit` on.
inline floatv coefficients(floatv numerator, float sum, float factor, floatv mean, floatv inverse,
                           int limit) {
  const floatv c = fma((floatv)(-sum), mean, numerator) * (factor * inverse);
  return select((floatv)(NO_SCORE), clamp(c, -1.0f, 1.0f),
                inverse > 0.0f && c == c && LANE_INDEX < limit);
}

// Mean and 1 / standard deviation (0: none) of the footprints centred on the target's pixels; a
// tile has BOX_COLUMNS x BOX_ROWS of them, in the order of rows.
__kernel void denominators(__global const PIXEL* restrict target, int width, int height,
                           int tiles_x, __global const int* restrict tiles, int count,
                           __global float* restrict means, __global float* restrict inverses) {
  if (get_global_id(0) >= (size_t)count) return;
  const int index = tiles[get_global_id(0)];
  const int x = HALF_W + (index % tiles_x) * BOX_COLUMNS, y = HALF_H + (index / tiles_x) * BOX_ROWS;
  const int rows = min(BOX_ROWS, height - HALF_H - y);
  __global const PIXEL* source = target + (size_t)(y - HALF_H) * width + x - HALF_W;
#define BOX_PITCH (((BOX_COLUMNS + TW + 1 + LANES - 1) / LANES) * LANES)
  const int x_end = width - HALF_W;
#if EXACT_BOX
  RowSums stored[BOX_ROWS + TH - 1];
  for (int r = 0; r < rows + TH - 1; ++r) {
    short row[BOX_PITCH];
    for (int c = 0; c < BOX_PITCH; c += LANES)
      STORE_SHORTS(VLOAD(source + (size_t)r * width + c), row + c);
    stored[r] = row_sums(row);
  }
  intv s[2] = {0, 0}, squares[2] = {0, 0};
  for (int r = 0; r < rows + TH - 1; ++r) {
    floatv mean[2], inverse[2];
#pragma unroll
    for (int o = 0; o < 2; ++o) {
      s[o] += stored[r].s[o];
      squares[o] += stored[r].squares[o];
      if (r >= TH - 1) {
        box_denominators(s[o], squares[o], mean + o, inverse + o);
        s[o] -= stored[r - TH + 1].s[o];
        squares[o] -= stored[r - TH + 1].squares[o];
      }
    }
    if (r < TH - 1) continue;
    const floatv m[2] = {ZIP_LOW(mean[0], mean[1]), ZIP_HIGH(mean[0], mean[1])};
    const floatv v[2] = {ZIP_LOW(inverse[0], inverse[1]), ZIP_HIGH(inverse[0], inverse[1])};
#else
    const float origin = pick_origin(source, width);
  float columns[BOX_ROWS][BOX_PITCH], columns2[BOX_ROWS][BOX_PITCH];
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < BOX_PITCH; c += LANES) {
      floatv sum = 0, squares = 0;
      for (int v = 0; v < TH; ++v) {
        const floatv p = TO_FLOAT(VLOAD(source + (size_t)(r + v) * width + c)) - origin;
        const floatv weighted = kWeightsY[v] * p;
        sum += weighted;
        squares += weighted * p;
      }
      VSTORE(sum, columns[r] + c);
      VSTORE(squares, columns2[r] + c);
    }
  for (int r = TH - 1; r < rows + TH - 1; ++r) {
    floatv m[2], v[2];
#pragma unroll
    for (int o = 0; o < 2; ++o) {
      floatv mean = 0, square = 0;
      for (int u = 0; u < TW; ++u) {
        mean += kWeightsX[u] * VLOAD(columns[r - TH + 1] + o * LANES + u);
        square += kWeightsX[u] * VLOAD(columns2[r - TH + 1] + o * LANES + u);
      }
      floatv variance = square - mean * mean;
      m[o] = mean + origin;
      // Little variance far from the origin has lost its digits: once more, about the mean.
      const floatv size = mean * mean;
      const intv lost = variance < LOST_DIGITS * size && variance > -LEAST_DIGITS * size;
      if (any(lost)) {
        floatv centred = 0;
        for (int v = 0; v < TH; ++v)
          for (int u = 0; u < TW; ++u) {
            const floatv d =
                TO_FLOAT(VLOAD(source + (size_t)(r - TH + 1 + v) * width + o * LANES + u)) - m[o];
            centred += kWeightsY[v] * kWeightsX[u] * d * d;
          }
        variance = select(variance, centred, lost);
      }
#ifdef FLOAT_IMAGE
      const floatv least = fmax(MIN_RELATIVE_VARIANCE * m[o] * m[o], MIN_VARIANCE);
      const intv scored = variance > least && isfinite(variance);
#else
      const intv scored = variance >= MIN_WEIGHTED_VARIANCE;
#endif
      v[o] = select((floatv)(0), inverse_root(variance), scored);
    }
#endif
    const size_t at = (size_t)(y + r - TH + 1) * width + x;
    if (x + BOX_COLUMNS <= x_end) {
      VSTORE(m[0], means + at);
      VSTORE(m[1], means + at + LANES);
      VSTORE(v[0], inverses + at);
      VSTORE(v[1], inverses + at + LANES);
    } else {
      float lanes[4 * LANES];
      VSTORE(m[0], lanes);
      VSTORE(m[1], lanes + LANES);
      VSTORE(v[0], lanes + 2 * LANES);
      VSTORE(v[1], lanes + 3 * LANES);
      for (int i = 0; i < x_end - x; ++i) {
        means[at + i] = lanes[i];
        inverses[at + i] = lanes[2 * LANES + i];
      }
    }
  }
}

// ---- coefficients ----------------------------------------------------------------------------

// Candidates are scored in blocks of OFFSETS * LANES columns; within a block, vector o holds the
// candidates o, o + OFFSETS, ...
#ifdef INTEGER
#define OFFSETS 2
typedef short patch_t;
typedef int tap_t;
typedef intv accv;
#define STORE_PATCH(v, p) STORE_SHORTS(v, p)
#define READ_UNIT(p) LOAD_PAIRS(p)
#define ACCUMULATE(acc, s, w) acc += MULTIPLY_PAIRS(s, (intv)(w))
#else
#define OFFSETS 1
typedef float patch_t;
typedef float tap_t;
typedef floatv accv;
#define STORE_PATCH(v, p) VSTORE(TO_FLOAT(v) - origin, p)
#define READ_UNIT(p) VLOAD(p)
#define ACCUMULATE(acc, s, w) acc = fma(s, (floatv)(w), acc)
#endif
#define BLOCK (OFFSETS * LANES)
#define PATCH_ROWS (PIECE_H + 2 + TH - 1 + ROWS)
#define PATCH_PITCH (((BLOCK + TW + LANES - 1) / LANES) * LANES)
#define SCORED_ROWS (PIECE_H + 2)

// Row r of the patch adds to the candidate rows j it is part of: low <= j <= high.
#define ADD_ROW(r, low, high)                                                  \
  {                                                                            \
    const patch_t* p = patch + (r) * PATCH_PITCH;                              \
    _Pragma("unroll") for (int u = 0; u < UNITS; ++u) {                        \
      accv s[OFFSETS];                                                         \
      _Pragma("unroll") for (int o = 0; o < OFFSETS; ++o) s[o] =               \
          READ_UNIT(p + OFFSETS * u + o);                                      \
      _Pragma("unroll") for (int j = 0; j < ROWS; ++j) if (j >= (low) && j <= (high)) { \
        const tap_t tap = taps[((r) - j) * UNITS + u];                         \
        _Pragma("unroll") for (int o = 0; o < OFFSETS; ++o)                    \
            ACCUMULATE(acc[j * OFFSETS + o], s[o], tap);                       \
      }                                                                        \
    }                                                                          \
  }

// Numerators of ROWS rows of a block.
inline void numerators(const patch_t* patch, const tap_t* taps, accv* out) {
  accv acc[ROWS * OFFSETS];
#pragma unroll
  for (int i = 0; i < ROWS * OFFSETS; ++i) acc[i] = 0;
#if TH >= ROWS
#pragma unroll
  for (int r = 0; r < ROWS - 1; ++r) ADD_ROW(r, 0, r)
#pragma nounroll
  for (int r = ROWS - 1; r < TH; ++r) ADD_ROW(r, 0, ROWS - 1)
#pragma unroll
  for (int r = TH; r < TH + ROWS - 1; ++r) ADD_ROW(r, r - TH + 1, ROWS - 1)
#else
#pragma unroll
  for (int r = 0; r < TH + ROWS - 1; ++r) ADD_ROW(r, max(r - TH + 1, 0), min(r, ROWS - 1))
#endif
#pragma unroll
  for (int i = 0; i < ROWS * OFFSETS; ++i) out[i] = acc[i];
}

// Coefficients of `columns` x `rows` candidates, rows <= SCORED_ROWS; the first is centred at the
// target's pixel (x, y).
inline void score(__global const PIXEL* target, int width, const tap_t* taps, float sum,
                  float factor, __global const float* means, __global const float* inverses, int x,
                  int y, int columns, int rows, __local float* out, int out_pitch) {
  patch_t patch[PATCH_ROWS * PATCH_PITCH];
#ifdef INTEGER  // uniform weights: denominators beside the numerators
  RowSums box[SCORED_ROWS + TH - 1];
#endif
  for (int left = 0; left < columns; left += BLOCK) {
    __global const PIXEL* source = target + (size_t)(y - HALF_H) * width + x + left - HALF_W;
#ifndef INTEGER
    const float origin = pick_origin(source, width);
#endif
    for (int r = 0; r < rows + TH - 1; ++r)
      for (int c = 0; c < PATCH_PITCH; c += LANES)
        STORE_PATCH(VLOAD(source + (size_t)r * width + c), patch + r * PATCH_PITCH + c);
#ifdef INTEGER
    intv s[2] = {0, 0}, squares[2] = {0, 0};
    for (int r = 0; r < rows + TH - 1; ++r) box[r] = row_sums(patch + r * PATCH_PITCH);
    for (int r = 0; r < TH - 1; ++r)
#pragma unroll
      for (int o = 0; o < 2; ++o) {
        s[o] += box[r].s[o];
        squares[o] += box[r].squares[o];
      }
#endif
    for (int first = 0; first < rows; first += ROWS) {
      accv acc[ROWS * OFFSETS];
      numerators(patch + first * PATCH_PITCH, taps, acc);
#pragma unroll
      for (int j = 0; j < ROWS; ++j) {
        const int r = first + j;
        if (r >= rows) break;
        floatv mean[OFFSETS], inverse[OFFSETS], number[OFFSETS];
#ifdef INTEGER
        const floatv even = TO_FLOAT(acc[2 * j]), odd = TO_FLOAT(acc[2 * j + 1]);
        number[0] = ZIP_LOW(even, odd);
        number[1] = ZIP_HIGH(even, odd);
#else
        number[0] = acc[j];
#endif
#ifdef INTEGER
        floatv m[2], v[2];
#pragma unroll
        for (int o = 0; o < 2; ++o) {
          s[o] += box[r + TH - 1].s[o];
          squares[o] += box[r + TH - 1].squares[o];
          box_denominators(s[o], squares[o], m + o, v + o);
          s[o] -= box[r].s[o];
          squares[o] -= box[r].squares[o];
        }
        mean[0] = ZIP_LOW(m[0], m[1]);
        mean[1] = ZIP_HIGH(m[0], m[1]);
        inverse[0] = ZIP_LOW(v[0], v[1]);
        inverse[1] = ZIP_HIGH(v[0], v[1]);
#else
        const size_t at = (size_t)(y + r) * width + x + left;
#pragma unroll
        for (int o = 0; o < OFFSETS; ++o) {
          mean[o] = VLOAD(means + at + o * LANES) - origin;
          inverse[o] = VLOAD(inverses + at + o * LANES);
        }
#endif
#pragma unroll
        for (int o = 0; o < OFFSETS; ++o)
          STORE_FLOATS(__local,
                       coefficients(number[o], sum, factor, mean[o], inverse[o],
                                    columns - left - o * LANES),
                       out + r * out_pitch + left + o * LANES);
      }
    }
  }
}

// ---- maxima ----------------------------------------------------------------------------------

// s: the coefficient of the piece's first candidate in rows of `pitch`.
inline void find_maxima(__global const Job* job, const Piece* piece, __local const float* s,
                        int pitch, float quality, __global Maxima* out) {
  floatv best_lanes = NO_SCORE;
  for (int y = 0; y < piece->height; ++y)
    for (int x = 0; x < piece->width; x += LANES) {
      const floatv c = VLOAD(s + y * pitch + x);
      best_lanes = fmax(best_lanes, select((floatv)(NO_SCORE), c, LANE_INDEX < piece->width - x));
    }
  float lanes[LANES];
  VSTORE(best_lanes, lanes);
  float best = NO_SCORE;
  for (int i = 0; i < LANES; ++i) best = fmax(best, lanes[i]);

  float value[MAX_PEAKS];
  int place[MAX_PEAKS], source[MAX_PEAKS];
  int kept = 0;
  const float threshold = peak_threshold(quality, best);
  // A maximum has all its neighbours in the window.
  const int reach_x = (job->flat & 2) != 0 ? 0 : 1, reach_y = (job->flat & 1) != 0 ? 0 : 1;
  const int x_begin = max(reach_x - piece->x, 0), y_begin = max(reach_y - piece->y, 0);
  const int x_end = min(piece->width, job->width - reach_x - piece->x);
  const int y_end = min(piece->height, job->height - reach_y - piece->y);
  const bool alone = reach_x == 0 && reach_y == 0;
  for (int y = y_begin; y < y_end && !alone; ++y)
    for (int x0 = x_begin; x0 < x_end; x0 += LANES) {
      __local const float* p = s + y * pitch + x0;
      const floatv c = VLOAD(p);
      intv candidate = c >= threshold && LANE_INDEX < x_end - x0;
      if (!any(candidate)) continue;
      for (int j = -reach_y; j <= reach_y; ++j)
        for (int i = -reach_x; i <= reach_x; ++i)
          if (i != 0 || j != 0) {
            const floatv n = VLOAD(p + j * pitch + i);
            candidate = candidate && c > n && n > NO_SCORE;
          }
      if (!any(candidate)) continue;
      int is_candidate[LANES];
      VSTORE(candidate, is_candidate);
      for (int i = 0; i < LANES; ++i)
        if (is_candidate[i])
          kept = keep_best(value, place, source, kept, p[i],
                           (piece->y + y) * job->width + piece->x + x0 + i, y * pitch + x0 + i);
    }
  out->best = best;
  out->count = kept;
  for (int k = 0; k < kept; ++k) {
    out->place[k] = place[k];
    for (int j = -1; j <= 1; ++j)
      for (int i = -1; i <= 1; ++i)
        out->around[k][3 * (j + 1) + i + 1] = abs(i) <= reach_x && abs(j) <= reach_y
                                                  ? s[source[k] + j * pitch + i]
                                                  : NO_SCORE;
  }
}

// Scores each piece with a rim of one candidate, and finds its maxima or copies its coefficients to
// the map (rows of the job's width).
__kernel void pieces(__global const PIXEL* restrict target, int target_width,
                     __global const Job* restrict jobs, __global const Piece* restrict list,
                     int count, __global const float* restrict stored,
                     __global const float* restrict means, __global const float* restrict inverses,
                     __local float* scratch, float quality, int wants_map,
                     __global float* restrict map, __global Maxima* restrict maxima) {
  const int index = get_global_id(0);
  if (index >= count) return;
  const Piece piece = list[index];
  __global const Job* job = jobs + piece.job;
  __global const float* mine = stored + (size_t)piece.job * STORED;
  const float sum = mine[SUM_AT];
  if (isnan(sum)) {
    maxima[index].best = NO_SCORE;
    maxima[index].count = 0;
    if (wants_map)
      for (int y = 0; y < piece.height; ++y)
        for (int x = 0; x < piece.width; ++x)
          map[(size_t)(piece.y + y) * job->width + piece.x + x] = NO_SCORE;
    return;
  }
  tap_t taps[TH * UNITS];
  for (int i = 0; i < TH * UNITS; ++i) taps[i] = ((__global const tap_t*)(mine + TAPS_AT))[i];
  const int x0 = max(piece.x - 1, 0), y0 = max(piece.y - 1, 0);
  const int columns = min(piece.x + piece.width + 1, job->width) - x0;
  const int rows = min(piece.y + piece.height + 1, job->height) - y0;
  // A margin of LANES, since maxima are looked for in whole vectors.
  const int pitch = ((columns + BLOCK - 1) / BLOCK) * BLOCK;
  score(target, target_width, taps, sum, mine[FACTOR_AT], means, inverses, job->x + x0, job->y + y0,
        columns, rows, scratch + LANES, pitch);
  __local const float* first = scratch + LANES + (piece.y - y0) * pitch + piece.x - x0;
  if (wants_map) {
    for (int y = 0; y < piece.height; ++y) {
      __global float* out = map + (size_t)(piece.y + y) * job->width + piece.x;
      int x = 0;
      for (; x + LANES <= piece.width; x += LANES)
        STORE_FLOATS(__global, VLOAD(first + y * pitch + x), out + x);
      for (; x < piece.width; ++x) out[x] = first[y * pitch + x];
    }
    return;
  }
  find_maxima(job, &piece, first, pitch, quality, maxima + index);
}
