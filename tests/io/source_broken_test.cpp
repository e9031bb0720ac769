#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <limits>

#include "io/image_file.h"
#include "io/source_images.h"
#include "io/source_test_files.h"

namespace corvid {
namespace {

namespace fs = std::filesystem;
using test::all_frames;
using test::has_note;
using test::open_error;
using test::opened;
using test::TempFolder;
using test::write_asl;
using test::write_image;
using test::write_text;
using testing::HasSubstr;

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

void replace_in(const std::string& path, const std::string& from, const std::string& to) {
  write_text(path, replaced(test::read_text(path), from, to));
}

TEST(BrokenSource, PathAbsent) {
  const auto source = open_source("/nowhere/at/all");
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().code, ErrorCode::not_found);
  EXPECT_EQ(source.error().where, "/nowhere/at/all");
}

TEST(BrokenSource, FolderThatIsNothing) {
  TempFolder t;
  write_text(t / "letter.doc", "hello");
  const auto source = open_source(t.path());
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().code, ErrorCode::unsupported);
  const std::string text = source.error().to_string();
  for (const char* part : {"letter.doc", "mav0/cam0/data.csv", "rgb.txt", "image_0", "_par.txt",
                           "*.camera", "frame-*", "cameras.txt", "jpg"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
  TempFolder empty;
  EXPECT_THAT(open_error(empty.path()), HasSubstr("the folder is empty"));
}

TEST(BrokenSource, FileThatIsNothing) {
  TempFolder t;
  write_text(t / "letter.doc", "hello");
  EXPECT_THAT(open_error(t / "letter.doc"), HasSubstr("no video"));
  write_image(t / "one.png");
  EXPECT_THAT(open_error(t / "one.png"), HasSubstr("give its folder: " + t.path()));
  write_text(t / "cut.mp4", "this is no video");
  EXPECT_THAT(open_error(t / "cut.mp4"), HasSubstr("cannot be opened"));
  EXPECT_THAT(open_error("/dev/null"), HasSubstr("no file and no folder"));
}

TEST(BrokenSource, MissingImagesAreSkippedAndCounted) {
  TempFolder t;
  write_asl(t.path(), 5);
  fs::remove(t / "mav0/cam0/data/1100000000.png");
  fs::remove(t / "mav0/cam0/data/1300000000.png");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[1]->id, FrameId(2)) << "a lost frame leaves a gap in the ids";
  EXPECT_EQ(source->counts().skipped, 2u);
  EXPECT_TRUE(has_note(source->counts().messages, "1100000000.png"));
}

TEST(BrokenSource, GapInNumberedImagesIsCounted) {
  TempFolder t;
  for (int i : {0, 1, 2, 5, 6}) write_image(t / ("image_0/00000" + std::to_string(i) + ".png"));
  write_text(t / "calib.txt", "P0: 30 0 16 0 0 30 12 0 0 0 1 0\n");
  write_text(t / "times.txt", "0\n0.1\n0.2\n0.3\n0.4\n0.5\n0.6\n");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 5u);
  EXPECT_EQ(frames[3]->time_ns, 500'000'000);
  EXPECT_EQ(source->counts().skipped, 2u);
  EXPECT_TRUE(has_note(source->counts().messages, "000003.png"));
}

TEST(BrokenSource, TruncatedImages) {
  for (const char* ending : {".png", ".jpg", ".bmp", ".tif", ".pgm"}) {
    for (const double share : {0.0, 0.1, 0.5, 0.9}) {
      TempFolder t;
      for (int i = 0; i < 3; ++i) {
        write_image(t / ("a" + std::to_string(i) + ending), 160, 120, i);
      }
      const std::string victim = t / (std::string("a1") + ending);
      test::truncate_file(victim, share);
      const auto source = opened(t.path());
      ASSERT_TRUE(source);
      EXPECT_EQ(all_frames(*source).size(), 2u) << ending << " " << share;
      EXPECT_EQ(source->counts().skipped, 1u) << ending << " " << share;
      EXPECT_TRUE(has_note(source->counts().messages, victim));
    }
  }
}

TEST(BrokenSource, TruncatedJpegWithThumbnailIsFound) {
  // A thumbnail's end-of-image marker in the EXIF segment must not pass for the picture's own.
  TempFolder t;
  write_image(t / "a.jpg", 160, 120);
  std::string jpeg = test::read_text(t / "a.jpg");
  const std::string segment("\xFF\xE1\x00\x06\xFF\xD9\xFF\xD9", 8);
  write_text(t / "whole.jpg", jpeg.substr(0, 2) + segment + jpeg.substr(2));
  EXPECT_TRUE(read_image(t / "whole.jpg"));
  write_text(t / "cut.jpg", jpeg.substr(0, 2) + segment + jpeg.substr(2, jpeg.size() - 200));
  const auto cut = read_image(t / "cut.jpg");
  ASSERT_FALSE(cut);
  EXPECT_THAT(cut.error().what, HasSubstr("cut off"));
}

TEST(BrokenSource, DamagedPixelsAndForeignContent) {
  TempFolder t;
  for (int i = 0; i < 4; ++i) write_image(t / ("a" + std::to_string(i) + ".png"), 160, 120, i);
  std::string bytes = test::read_text(t / "a1.png");
  for (std::size_t i = bytes.size() / 2; i < bytes.size() / 2 + 8; ++i) bytes[i] ^= 0x5A;
  write_text(t / "a1.png", bytes);
  write_text(t / "a2.png", "<html>404 not found</html>");
  fs::create_directory(t / "a4.png");  // a folder by an image's name is no image
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 2u);
  EXPECT_EQ(source->counts().skipped, 2u);
}

TEST(BrokenSource, NoImageCanBeRead) {
  TempFolder t;
  write_asl(t.path(), 3);
  fs::remove_all(t / "mav0/cam0/data");
  EXPECT_THAT(open_error(t.path()), HasSubstr("none of the 3 images can be read"));
  TempFolder zero;
  for (const char* name : {"a.png", "b.png"}) write_text(zero / name, "");
  EXPECT_THAT(open_error(zero.path()), HasSubstr("empty"));
}

TEST(BrokenSource, AllFramesBadAfterOpeningIsAnErrorOfTheFirstNext) {
  TempFolder t;
  for (int i = 0; i < 3; ++i) write_image(t / ("a" + std::to_string(i) + ".png"));
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  for (int i = 0; i < 3; ++i) fs::remove(t / ("a" + std::to_string(i) + ".png"));
  const auto frame = source->next();
  ASSERT_FALSE(frame);
  EXPECT_THAT(frame.error().to_string(), HasSubstr("none of the 3 images could be used"));
  EXPECT_EQ(source->counts().skipped, 3u);
}

TEST(BrokenSource, EmptyCsv) {
  for (const char* text : {"", "#timestamp [ns],filename\n", "\xEF\xBB\xBF\r\n\r\n"}) {
    TempFolder t;
    write_asl(t.path());
    write_text(t / "mav0/cam0/data.csv", text);
    const std::string error = open_error(t.path());
    EXPECT_THAT(error, HasSubstr("lists no image"));
    EXPECT_THAT(error, HasSubstr("data.csv"));
  }
  TempFolder t;
  write_asl(t.path());
  fs::remove(t / "mav0/cam0/data.csv");
  EXPECT_THAT(open_error(t.path()), HasSubstr("data.csv"));
}

TEST(BrokenSource, GarbageLinesAreNamed) {
  TempFolder t;
  write_asl(t.path());
  replace_in(t / "mav0/cam0/data.csv", "1100000000,", "11x00,");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 3u);
  EXPECT_EQ(source->counts().skipped, 1u);
  EXPECT_TRUE(has_note(source->counts().messages, "data.csv:3:"));
}

TEST(BrokenSource, WrongCalibrationKeys) {
  struct Case {
    const char *from, *to, *expected, *nearest;
  };
  for (const Case& c : {Case{"intrinsics", "intrinsic", "intrinsic", "intrinsics"},
                        Case{"distortion_coefficients", "distorsion_coefficients",
                             "distorsion_coefficients", "distortion_coefficients"},
                        Case{"resolution", "resolutoin", "resolutoin", "resolution"},
                        Case{"T_BS", "T_SB", "T_SB", "T_BS"}}) {
    TempFolder t;
    write_asl(t.path());
    replace_in(t / "mav0/cam0/sensor.yaml", c.from, c.to);
    const std::string error = open_error(t.path());
    EXPECT_THAT(error, HasSubstr("sensor.yaml"));
    EXPECT_THAT(error, HasSubstr(std::string("\"") + c.expected + "\""));
    EXPECT_THAT(error, HasSubstr(std::string("did you mean ") + c.nearest));
  }
  TempFolder t;
  write_image(t / "image_0/000000.png");
  write_text(t / "calib.txt", "P_0: 30 0 16 0 0 30 12 0 0 0 1 0\n");
  EXPECT_THAT(open_error(t.path()), HasSubstr("\"P_0\""));
}

TEST(BrokenSource, WrongCalibrationValues) {
  struct Case {
    const char *from, *to, *expected;
  };
  for (const Case& c :
       {Case{"30.5", "nan", "not a finite number"}, Case{"30.5", ".inf", "not a finite number"},
        Case{"30.5", "-30.5", "fx"}, Case{"30.5,", "", "intrinsics"},
        Case{"[32, 24]", "[0, 24]", "image size"}, Case{"[32, 24]", "[1e30, 1e30]", "image size"},
        Case{"radial-tangential", "radial-tangental", "radial-tangential"},
        Case{"camera_model: pinhole", "camera_model: omni", "omni"},
        Case{"[0.0, -1.0", "[0.0, -7.0", "rotation"}, Case{"[32, 24]", "[32, 24", "YAML"}}) {
    TempFolder t;
    write_asl(t.path());
    replace_in(t / "mav0/cam0/sensor.yaml", c.from, c.to);
    EXPECT_THAT(open_error(t.path()), HasSubstr(c.expected)) << c.from << " " << c.to;
  }
}

TEST(BrokenSource, CalibrationOfAnotherSize) {
  TempFolder t;
  write_asl(t.path());
  replace_in(t / "mav0/cam0/sensor.yaml", "[32, 24]", "[64, 48]");  // twice: scaled, and said
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(source->info().camera->width_px, 32);
  EXPECT_NEAR(source->info().camera->fx_px, 30.5 / 2, 1e-12);
  EXPECT_NEAR(source->info().camera->cx_px, (15.25 + 0.5) / 2 - 0.5, 1e-12);
  EXPECT_TRUE(has_note(source->info().notes, "scaled"));
  replace_in(t / "mav0/cam0/sensor.yaml", "[64, 48]", "[64, 40]");
  const std::string error = open_error(t.path());
  EXPECT_THAT(error, HasSubstr("64 x 40"));
  EXPECT_THAT(error, HasSubstr("32 x 24"));
}

TEST(BrokenSource, TimesThatGoBackOrRepeat) {
  TempFolder t;
  write_asl(t.path(), 6);
  replace_in(t / "mav0/cam0/data.csv", "1300000000,", "900000000,");   // goes back
  replace_in(t / "mav0/cam0/data.csv", "1500000000,", "1400000000,");  // repeats
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  const auto frames = all_frames(*source);
  ASSERT_EQ(frames.size(), 4u);
  for (std::size_t i = 1; i < frames.size(); ++i) {
    EXPECT_LT(frames[i - 1]->time_ns, frames[i]->time_ns);
  }
  EXPECT_EQ(source->counts().skipped, 2u);
  EXPECT_TRUE(has_note(source->counts().messages, "900000000"));
}

TEST(BrokenSource, OneTimeFarAheadCostsOneFrame) {
  EXPECT_EQ(times_out_of_order({1, 2, 100, 3, 4, 5}),
            (std::vector<bool>{false, false, true, false, false, false}));
  EXPECT_EQ(times_out_of_order({1, 2, 3, 2, 4}),
            (std::vector<bool>{false, false, false, true, false}));
  EXPECT_EQ(times_out_of_order({7, 7, 7}), (std::vector<bool>{false, true, true}));
  EXPECT_EQ(times_out_of_order({}), std::vector<bool>{});
  EXPECT_EQ(times_out_of_order({5, 6, 7, 1, 2}),
            (std::vector<bool>{false, false, false, true, true}));
}

TEST(BrokenSource, ImagesOfChangingSize) {
  TempFolder t;
  for (int i = 0; i < 5; ++i) {
    write_image(t / ("a" + std::to_string(i) + ".png"), i == 2 ? 40 : 32, 24, i);
  }
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 4u);
  EXPECT_EQ(source->counts().skipped, 1u);
  EXPECT_TRUE(has_note(source->counts().messages, "40 x 24 pixels but the first has 32 x 24"));
}

TEST(BrokenSource, TruthThatIsBrokenIsLeftOutWithANote) {
  TempFolder t;
  write_asl(t.path());
  replace_in(t / "mav0/state_groundtruth_estimate0/data.csv", "3.5,2,3", "3.5,nan,3");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_TRUE(source->truth().empty());
  EXPECT_TRUE(has_note(source->info().notes, "data.csv:5:"));
  EXPECT_EQ(all_frames(*source).size(), 4u);
}

TEST(BrokenSource, WindowsLineEndsAndUnicodeNames) {
  TempFolder t;
  const std::string root = t / "Überflug 飛行";
  write_asl(root);
  for (const char* name : {"/mav0/cam0/data.csv", "/mav0/cam0/sensor.yaml",
                           "/mav0/state_groundtruth_estimate0/data.csv"}) {
    std::string crlf = "\xEF\xBB\xBF";
    for (const char c : test::read_text(root + name))
      crlf += c == '\n' ? "\r\n" : std::string(1, c);
    write_text(root + name, crlf);
  }
  const auto source = opened(root);
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 4u);
  EXPECT_EQ(source->truth().size(), 40u);
  EXPECT_EQ(source->counts().skipped, 0u);
}

TEST(BrokenSource, UnreadableFiles) {
  TempFolder t;
  write_asl(t.path());
  // Dangling links cannot be read, not even by the administrator.
  fs::remove(t / "mav0/cam0/data/1100000000.png");
  fs::create_symlink("/nowhere", t / "mav0/cam0/data/1100000000.png");
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 3u);
  fs::remove(t / "mav0/cam0/data.csv");
  fs::create_directory(t / "mav0/cam0/data.csv");
  EXPECT_THAT(open_error(t.path()), HasSubstr("data.csv"));
}

TEST(BrokenSource, OptionsThatMakeNoSense) {
  TempFolder t;
  write_asl(t.path());
  SourceOptions options;
  options.step = 0;
  EXPECT_THAT(open_error(t.path(), options), HasSubstr("step"));
  options = {};
  options.first = -1;
  EXPECT_THAT(open_error(t.path(), options), HasSubstr("first"));
  options = {};
  options.rate_hz = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(open_error(t.path(), options), HasSubstr("rate_hz"));
  options = {};
  options.first = std::numeric_limits<int>::max();
  EXPECT_THAT(open_error(t.path(), options), HasSubstr("none is left"));
  options = {};
  options.calibration_path = t / "absent.yaml";
  EXPECT_THAT(open_error(t.path(), options), HasSubstr("absent.yaml"));
  options = {};
  options.count = options.step = std::numeric_limits<int>::max();
  const auto source = opened(t.path(), options);
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 1u);
}

TEST(BrokenSource, MessagesAreLimited) {
  TempFolder t;
  write_asl(t.path(), 1);
  std::string csv = test::read_text(t / "mav0/cam0/data.csv");
  for (int i = 0; i < 5000; ++i) {
    csv += std::to_string(2'000'000'000LL + i) + ",gone.png\n";
  }
  write_text(t / "mav0/cam0/data.csv", csv);
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  EXPECT_EQ(all_frames(*source).size(), 1u);
  EXPECT_EQ(source->counts().skipped, 5000u);
  EXPECT_EQ(source->counts().messages.size(), 100u);
}

TEST(BrokenSource, StopEndsTheSource) {
  TempFolder t;
  write_asl(t.path());
  const auto source = opened(t.path());
  ASSERT_TRUE(source);
  std::stop_source stop;
  stop.request_stop();
  const auto frame = source->next(stop.get_token());
  ASSERT_TRUE(frame);
  EXPECT_EQ(*frame, nullptr);
}

}  // namespace
}  // namespace corvid
