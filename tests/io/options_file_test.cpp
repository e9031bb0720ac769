#include "io/options_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstddef>
#include <set>

#include "io/nearest_name.h"

namespace corvid {
namespace {

using ::testing::HasSubstr;

// Converts to anything: how many of them an aggregate takes is how many members it has.
struct Anything {
  template <class T>
  operator T() const;  // NOLINT: implicit on purpose, never defined
};

template <class Aggregate, class... Members>
constexpr std::size_t count_members() {
  if constexpr (requires { Aggregate{Members{}..., Anything{}}; }) {
    return count_members<Aggregate, Members..., Anything>();
  } else {
    return sizeof...(Members);
  }
}

std::size_t rows_of(std::string_view section) {
  std::size_t count = 0;
  for (const OptionField& field : option_fields()) {
    const std::size_t dot = field.key.find('.');
    const std::string_view own =
        dot == std::string_view::npos ? std::string_view() : field.key.substr(0, dot);
    if (own == section) ++count;
  }
  return count;
}

TEST(OptionTable, HasEveryMemberOfEveryAggregate) {
  EXPECT_EQ(rows_of("frontend"), count_members<FrontendOptions>());
  EXPECT_EQ(rows_of("backend"), count_members<BackendOptions>());
  EXPECT_EQ(rows_of("place"), count_members<PlaceOptions>());
  EXPECT_EQ(rows_of("mapping"), count_members<MappingOptions>());
  std::set<std::string_view> sections;
  for (const OptionField& field : option_fields()) {
    const std::size_t dot = field.key.find('.');
    if (dot != std::string_view::npos) sections.insert(field.key.substr(0, dot));
  }
  EXPECT_EQ(sections.size() + rows_of(""), count_members<Options>());
}

TEST(OptionTable, NoTwoRowsShareAKeyOrAMember) {
  Options options;
  std::set<std::string_view> keys;
  std::set<const void*> members;
  for (const OptionField& field : option_fields()) {
    keys.insert(field.key);
    members.insert(
        std::visit([](auto* p) { return static_cast<const void*>(p); }, field.pointer(options)));
    EXPECT_FALSE(field.doc.empty()) << field.key;
  }
  EXPECT_EQ(keys.size(), option_fields().size());
  EXPECT_EQ(members.size(), option_fields().size());
}

// A value of each option that differs from its default.
void change(OptionPointer pointer) {
  if (auto* b = std::get_if<bool*>(&pointer)) **b = !**b;
  if (auto* i = std::get_if<int*>(&pointer)) **i += 2;
  if (auto* d = std::get_if<double*>(&pointer)) **d = **d * (1.0 + 1e-3) + 1e-7 / 3;
  if (auto* u = std::get_if<std::uint64_t*>(&pointer)) **u += (1ULL << 63);
  if (auto* s = std::get_if<std::string*>(&pointer)) **s = "gpu";
}

TEST(OptionsFile, RoundTripsEveryOptionExactly) {
  for (const OptionField& changed : option_fields()) {
    Options options;
    change(changed.pointer(options));
    if (!options.validate().empty()) {
      // e.g. a share that may not exceed one: the other direction.
      options = {};
      const auto p = changed.pointer(options);
      if (std::holds_alternative<double*>(p)) *std::get<double*>(p) *= 1.0 - 1e-3 / 3;
      if (std::holds_alternative<std::string*>(p)) *std::get<std::string*>(p) = "all";
    }
    ASSERT_TRUE(options.validate().empty()) << changed.key;
    ASSERT_NE(changed.text(options), changed.text(Options{})) << changed.key;
    const auto read = parse_options(options_to_yaml(options), "memory");
    ASSERT_TRUE(read) << read.error().to_string();
    for (const OptionField& field : option_fields()) {
      EXPECT_EQ(field.text(*read), field.text(options)) << changed.key << " moved " << field.key;
    }
  }
}

TEST(OptionsFile, ReadsSectionsDottedKeysAndKeepsTheRest) {
  Options base;
  base.backend.window_keyframes = 7;
  const auto read = parse_options(
      "# mine\nfrontend:\n  max_tracks: 300\nmapping.enabled: false\nbackend:\ndevice: cpu\n",
      "memory", base);
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->frontend.max_tracks, 300);
  EXPECT_FALSE(read->mapping.enabled);
  EXPECT_EQ(read->device, "cpu");
  EXPECT_EQ(read->backend.window_keyframes, 7);
  EXPECT_EQ(read->frontend.template_px, Options{}.frontend.template_px);
}

TEST(OptionsFile, AnEmptyFileIsTheDefaults) {
  for (const char* text : {"", "\n", "# nothing\n", "---\n"}) {
    const auto read = parse_options(text, "memory");
    ASSERT_TRUE(read) << read.error().to_string();
    EXPECT_EQ(options_to_yaml(*read), options_to_yaml(Options{}));
  }
}

std::string error_of(const std::string& yaml) {
  const auto read = parse_options(yaml, "my.yaml");
  if (read) return "no error";
  EXPECT_EQ(read.error().code, ErrorCode::invalid_argument);
  return read.error().to_string();
}

TEST(OptionsFile, AnUnknownKeyNamesItsLineAndTheNearestKnownKey) {
  const std::string nested = error_of("frontend:\n  seed: 3\n  max_trakcs: 3\n");
  EXPECT_THAT(nested, HasSubstr("my.yaml:3"));
  EXPECT_THAT(nested, HasSubstr("unknown option frontend.max_trakcs"));
  EXPECT_THAT(nested, HasSubstr("did you mean frontend.max_tracks?"));
  EXPECT_THAT(error_of("max_tracks: 3\n"), HasSubstr("did you mean frontend.max_tracks?"));
  EXPECT_THAT(error_of("\nfrontent:\n  max_tracks: 3\n"), HasSubstr("my.yaml:2"));
  EXPECT_THAT(error_of("zzzzzzzz: 3\n"), HasSubstr("`corvid options` prints every key"));
}

TEST(OptionsFile, WrongTypesNameTheLineAndTheKind) {
  const std::string word = error_of("frontend:\n  max_tracks: many\n");
  EXPECT_THAT(word, HasSubstr("my.yaml:2"));
  EXPECT_THAT(word, HasSubstr("frontend.max_tracks takes a value of the kind `whole number`"));
  EXPECT_THAT(error_of("frontend: {max_tracks: 3.5}\n"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("frontend: {max_tracks: 99999999999}\n"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("frontend: {max_tracks: [1, 2]}\n"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("frontend: {seed: -1}\n"), HasSubstr("not negative"));
  EXPECT_THAT(error_of("frontend: {min_score: .nan}\n"), HasSubstr("number"));
  EXPECT_THAT(error_of("frontend: {min_score: 1e999}\n"), HasSubstr("number"));
  EXPECT_THAT(error_of("mapping: {enabled: 2}\n"), HasSubstr("true or false"));
  EXPECT_THAT(error_of("device:\n"), HasSubstr("text"));
}

TEST(OptionsFile, MalformedFilesAreRefused) {
  EXPECT_THAT(error_of("frontend: {max_tracks: 3\n"), HasSubstr("not valid YAML"));
  EXPECT_THAT(error_of("- 1\n- 2\n"), HasSubstr("not a list of options"));
  EXPECT_THAT(error_of("frontend: 3\n"), HasSubstr("frontend is a section"));
  EXPECT_THAT(error_of("threads: 1\nthreads: 2\n"), HasSubstr("threads is given twice"));
  EXPECT_THAT(error_of("frontend: {seed: 1}\nfrontend.seed: 2\n"), HasSubstr("given twice"));
  EXPECT_THAT(error_of("? [a, b]\n: 3\n"), HasSubstr("a key is not a word"));
}

TEST(OptionsFile, ValuesAreValidatedTogether) {
  const std::string both = error_of("frontend: {max_tracks: -3}\nbackend: {max_error_px: -1}\n");
  EXPECT_THAT(both, HasSubstr("frontend.max_tracks"));
  EXPECT_THAT(both, HasSubstr("backend.max_error_px"));
}

TEST(OptionsFile, FilesThatAreAbsentOrNotFilesAreErrors) {
  const std::string folder = ::testing::TempDir();
  const auto absent = read_options_file(folder + "/no_such_options.yaml");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::not_found);
  const auto not_a_file = read_options_file(folder);
  ASSERT_FALSE(not_a_file);

  Options options;
  options.frontend.max_tracks = 123;
  const std::string path = folder + "/corvid_options_file_test.yaml";
  ASSERT_TRUE(write_options_file(path, options));
  const auto read = read_options_file(path);
  ASSERT_TRUE(read) << read.error().to_string();
  EXPECT_EQ(read->frontend.max_tracks, 123);
  EXPECT_FALSE(write_options_file(path + "/below_a_file/o.yaml", options));
}

TEST(SetOption, ReportsWhereTheTextCameFrom) {
  Options options;
  ASSERT_TRUE(set_option(options, "threads", "1", "--set"));
  EXPECT_EQ(options.threads, 1);
  const auto wrong = set_option(options, "thread", "1", "--set");
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().to_string(), "--set: unknown option thread (did you mean threads?)");
}

TEST(NearestName, FindsTyposAndForgottenSectionsOnly) {
  const std::vector<std::string> names = {"--device", "--threads", "a.depth", "b.depth"};
  EXPECT_EQ(nearest_name("--devcie", names), "--device");
  EXPECT_EQ(nearest_name("--THREADS", names), "--threads");
  EXPECT_EQ(nearest_name("depth", names), "a.depth");
  EXPECT_EQ(nearest_name("banana", names), "");
  EXPECT_EQ(nearest_name("", names), "");
}

}  // namespace
}  // namespace corvid
