// Paths of the images and material files that a model refers to.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "render/model/model_parts.hpp"
#include "support/model_text.hpp"

namespace penumbra {
namespace {

using namespace std::string_view_literals;

TEST(ModelResourcePath, KeepsRelativePaths) {
  for (const std::string name :
       {"t.png", "pictures/t.png", "my image.png", "a/b:c.png", "..t.png", "a/t..png"}) {
    EXPECT_EQ(model_resource_path("m", name).value(), "m/" + name);
    EXPECT_FALSE(leaves_folder(name)) << name;
  }
}

TEST(ModelResourcePath, FindsLatin1NamesStoredAsUtf8) {
  const test::ModelFolder folder;
  const auto utf8 = folder.write("B\xC3\xA4r.png", "");
  EXPECT_EQ(model_resource_path(folder.path(), "B\xE4r.png").value(), utf8);
  // A file with the name as written has priority over a file with the converted name.
  const auto latin1 = folder.write("B\xE4r.png", "");
  EXPECT_EQ(model_resource_path(folder.path(), "B\xE4r.png").value(), latin1);
}

TEST(ModelResourcePath, ReadsBackslashesAsSlashes) {
  EXPECT_EQ(model_resource_path("m", R"(.\t.png)").value(), "m/./t.png");
  EXPECT_EQ(model_resource_path("m", R"(pictures\\wood\t.png)").value(), "m/pictures//wood/t.png");
  EXPECT_FALSE(leaves_folder(R"(pictures\t.png)"));
}

TEST(ModelResourcePath, SkipsFileScheme) {
  EXPECT_EQ(model_resource_path("m", "file:t.png").value(), "m/t.png");
  EXPECT_EQ(model_resource_path("m", "FILE:a/t.png").value(), "m/a/t.png");
  EXPECT_EQ(model_resource_path("m", "file:///home/me/t.png").value(), "m/t.png");
}

TEST(ModelResourcePath, UsesFileNameOfPathOutsideFolder) {
  for (const std::string name :
       {"/t.png", "/etc/t.png", "../t.png", "a/../../t.png", "a/../t.png", R"(..\t.png)",
        R"(C:\Users\me\t.png)", "c:/t.png", "C:t.png", R"(\\server\share\t.png)", "//server/t.png",
        "http://example.com/t.png", "file://server/share/t.png", "file:///C:/t.png",
        R"(file:..\t.png)"}) {
    EXPECT_EQ(model_resource_path("m", name).value(), "m/t.png") << name;
    EXPECT_TRUE(leaves_folder(name)) << name;
  }
}

TEST(ModelResourcePath, RejectsPathWithoutFileName) {
  for (const std::string_view name :
       {""sv, "."sv, ".."sv, "/"sv, "a/"sv, "../.."sv, "a/."sv, "C:"sv, R"(C:\)"sv, "C:.."sv,
        "file:"sv, "t.png\0"sv, "a\0/t.png"sv}) {
    const auto path = model_resource_path("m", name);
    ASSERT_FALSE(path) << name;
    EXPECT_THAT(path.error().message, testing::HasSubstr("names no file beside the model"));
  }
}

}  // namespace
}  // namespace penumbra
