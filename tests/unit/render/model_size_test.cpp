// Units and sizes of models from files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "render/model.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

// A square of 64 by 64 units in the plane z = 32.
constexpr const char* kSquare = "v 0 0 32\nv 64 0 32\nv 64 64 32\nv 0 64 32\nf 1 2 3 4\n";

class ModelSize : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& name, const std::string& text) {
    const std::filesystem::path file = folder_.path() / name;
    std::ofstream(file, std::ios::binary) << text;
    return file;
  }

 private:
  test::TemporaryFolder folder_;
};

TEST_F(ModelSize, UnitTurnsCoordinatesIntoMetres) {
  const std::filesystem::path file = write("square.obj", kSquare);
  const Result<Model> model = load_model(file, {.unit_m = 0.001});
  ASSERT_TRUE(model);
  EXPECT_EQ(model->min_corner, glm::vec3(0.0F, 0.0F, 0.032F));
  EXPECT_EQ(model->max_corner, glm::vec3(0.064F, 0.064F, 0.032F));
}

TEST_F(ModelSize, LimitOfCoordinatesIsInMetres) {
  const std::filesystem::path file =
      write("far.obj", "v 2000000 0 0\nv 2000001 0 0\nv 2000000 1 0\nf 1 2 3\n");
  EXPECT_FALSE(load_model(file));
  EXPECT_TRUE(load_model(file, {.unit_m = 0.001}));
}

}  // namespace
}  // namespace penumbra
