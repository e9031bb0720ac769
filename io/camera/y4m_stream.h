#pragma once

#include <memory>
#include <stop_token>

#include "core/clock.h"
#include "corvid/error.h"
#include "io/camera/camera_stream.h"

namespace corvid {

/// Reads YUV4MPEG2 from the standard input (device `-`) or a fifo:
/// `ffmpeg ... -f yuv4mpegpipe - | corvid live --camera y4m:-`. A file is refused: it has no pace.
///
/// The luma is the grey picture, as it is (16..235 stays so); of more than 8 bits the upper 8.
/// Capture times: the arrival of the first frame, then the count by the stream's rate, for a pipe
/// has no times; but never later than the arrival: a frame that comes early moves the count back,
/// so that it follows the least delay. A frame that arrives more than 0.5 s after its counted time
/// begins the count anew; where that happens again and again the rate is wrong, and times are those
/// of arrival from then on, as without a rate (no F, F0:0). Times rise strictly. The sequence is
/// the number of the frame. A last frame that is cut off is counted as damaged, and ended() becomes
/// true; so it does after what is no frame, which is an error (io).
///
/// @param request  its sizes, rate, format, exposure and gain cannot be asked of a pipe: notes say
/// so.
/// @param clock    gives the times of arrival; outlives the stream.
/// @param stop     ends the wait for the header, which lasts 10 s at most.
/// Errors: not_found, io (cannot be opened, no header in time), and those of parse_y4m_header.
[[nodiscard]] Expected<std::unique_ptr<CameraStream>> open_y4m(const CameraRequest& request,
                                                               Clock& clock,
                                                               const std::stop_token& stop = {});

}  // namespace corvid
