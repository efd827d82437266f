// Damaged scenes are rejected with an error of one line, or load as valid scenes. Deterministic.
#include <gtest/gtest.h>

#include <fstream>
#include <random>
#include <string>

#include "render/scene/scene.hpp"
#include "support/paths.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

TEST(SceneFuzz, LoadsOrRejectsDamagedScene) {
  std::ifstream stream(test::source_dir() / "scenes/default.json");
  std::string good((std::istreambuf_iterator<char>(stream)), {});
  // Primitive shapes replace the models, because reading models takes long.
  for (const std::string name : {"helicopter", "helicopter_rotor", "helicopter_tail_rotor"}) {
    const std::string model = "\"model\": \"models/" + name + ".glb\"";
    ASSERT_NE(good.find(model), std::string::npos);
    good.replace(good.find(model), model.size(), R"("shape": {"kind": "sphere", "radius": 0.05})");
  }
  test::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "scene.json";
  const std::string words[] = {"-1", "1e30", "\"x\"", "null", "[]", "{}", "0", "true", "1e-30"};
  std::mt19937 random(5);
  int accepted = 0;
  const int count = test::nightly() ? 3000 : 1000;
  for (int i = 0; i < count; ++i) {
    std::string text = good;
    const std::size_t at = random() % text.size();
    switch (random() % 4) {
      case 0:
        text[at] = static_cast<char>(random() & 0xFFU);
        break;
      case 1:
        text.erase(at, 1 + random() % 8);
        break;
      default: {  // replaces a number
        const std::size_t from = std::min(text.find_first_of("0123456789", at), text.size());
        const std::size_t to = std::min(text.find_first_not_of("0123456789.", from), text.size());
        text.replace(from, to - from, words[random() % std::size(words)]);
      }
    }
    // Creates a new file, because some file systems flush a truncated file to the disk.
    std::filesystem::remove(file);
    std::ofstream(file, std::ios::binary) << text;
    const Result<Scene> scene = load_scene(file);
    if (!scene) {
      EXPECT_EQ(scene.error().message.find('\n'), std::string::npos) << scene.error().message;
      EXPECT_NE(scene.error().message.find("scene.json: "), std::string::npos);
      continue;
    }
    ++accepted;
    for (const double time : {0.0, 0.5, 3.3, 7.99, 12.0, 1e6}) {
      for (const Placement& placement : evaluate_scene(*scene, time).objects) {
        ASSERT_TRUE(placement.position.allFinite() && placement.rotation.coeffs().allFinite());
        ASSERT_GT(placement.scale, 0.0);
      }
    }
  }
  EXPECT_GT(accepted, 0);
  EXPECT_LT(accepted, count);
}

}  // namespace
}  // namespace penumbra
