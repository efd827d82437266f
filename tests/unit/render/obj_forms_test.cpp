// OBJ and MTL files of other programs.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.hpp"
#include "support/model_text.hpp"
#include "support/mutate.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

using test::area_of;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

const std::string kCorners = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\n";
const std::string kRed = "newmtl red\nKd 1 0 0\n";
const std::string kRedSquare = "usemtl red\nf 1 2 3 4\n";

class ObjModelFile : public testing::Test {
 protected:
  // Expects a square of 100 cm^2 and warnings that match `warnings`.
  template <class Matcher>
  void expect_square(const std::string& text, const Matcher& warnings) {
    const Result<Model> model = folder_.obj(text);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_NEAR(area_of(*model), 0.01, 1e-8) << text;
    EXPECT_THAT(model->warnings, warnings) << text;
  }
  // Returns the material of the square's first face, read from this .mtl text.
  Material material_of(const std::string& mtl, std::string* warning = nullptr) {
    folder_.write("m.mtl", mtl);
    const Result<Model> model = folder_.obj("mtllib m.mtl\n" + kCorners + kRedSquare);
    if (!model) {
      ADD_FAILURE() << model.error().message;
      return {};
    }
    if (warning == nullptr) {
      EXPECT_THAT(model->warnings, IsEmpty()) << mtl;
    } else {
      EXPECT_THAT(model->warnings, testing::SizeIs(1)) << mtl;
      *warning = model->warnings.empty() ? "" : model->warnings[0];
    }
    return model->materials.at(static_cast<std::size_t>(model->meshes[0].material));
  }
  glm::vec4 color_of(const std::string& mtl, std::string* warning = nullptr) {
    return material_of(mtl, warning).base_color;
  }
  test::ModelFolder folder_;
};

TEST_F(ObjModelFile, AcceptsCornersEndingInSlashes) {
  for (const std::string face : {"f 1/ 2/ 3/ 4/", "f 1// 2// 3// 4//", "f 1/0/0 2/0 3//0 4"}) {
    expect_square(kCorners + face + "\n", IsEmpty());
  }
  expect_square(kCorners + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1/ 2/2/ 3/3/ 4/4/\n", IsEmpty());
  expect_square(kCorners + "vn 0 0 1\nf 1/0/1 2/0/1 3/0/1 4/0/1\n", IsEmpty());
}

TEST_F(ObjModelFile, ReportsDecimalCommas) {
  const Result<Model> model = folder_.obj("v 0 0 0\nv 0,5 0,0 1,0\n");
  ASSERT_FALSE(model);
  EXPECT_THAT(model.error().message, HasSubstr("line 2: \"0,5\" has a decimal comma"));
  for (const char* number : {"0,5,1", "0.5,", ",", "a,b"}) {
    const Result<Model> rejected = folder_.obj(fmt::format("v {} 0 0\n", number));
    ASSERT_FALSE(rejected) << number;
    EXPECT_THAT(rejected.error().message, testing::Not(HasSubstr("decimal comma"))) << number;
  }
  std::string warning;
  material_of("newmtl red\nKd 0,8 0,8 0,8\n", &warning);
  EXPECT_THAT(warning, HasSubstr("decimal commas"));
}

TEST_F(ObjModelFile, AcceptsCommentsAnywhere) {
  expect_square("v 0 0 0 # first\nv 0.1 0 0\nv 0.1 0.1 0 #third\nv 0 0.1 0\nf 1 2 3 4 # bottom\n",
                IsEmpty());
}

TEST_F(ObjModelFile, SkipsAndReportsFacesWithoutSurface) {
  expect_square(kCorners + "f 1 2 3 4\nf 1\nf 1 2\n",
                ElementsAre(AllOf(HasSubstr("line 6: a face has fewer than 3 corners"),
                                  HasSubstr("(2 such lines)"))));
  expect_square(kCorners + "f 1 2 3 4\nl 1 2\np 1\n",
                ElementsAre(HasSubstr("line 6: lines and points have no surface")));
  expect_square(kCorners + "cstype bezier\nf 1 2 3 4\n", ElementsAre(HasSubstr("free-form")));
  expect_square(kCorners + "f 1 2 3 4\nfnord\n",
                ElementsAre(HasSubstr("line 6: a line does not start with a word of the OBJ")));
}

TEST_F(ObjModelFile, ReportsAbsentNormalsAndTextureCoordinates) {
  expect_square(kCorners + "f 1//1 2//1 3//1 4//1\n",
                ElementsAre(HasSubstr("line 5: a face names a normal that is not there")));
  expect_square(kCorners + "f 1/1 2/-3 3/3 4/4\n",
                ElementsAre(HasSubstr("line 5: a face names a texture coordinate that is not")));
  expect_square(kCorners + "vn nan 0 1\nvn 0 0 0\nf 1//1 2//2 3//1 4//2\n",
                ElementsAre(AllOf(HasSubstr("line 5: a normal is not a direction"),
                                  HasSubstr("(2 such lines)"))));
}

TEST_F(ObjModelFile, IgnoresNonFiniteColours) {
  expect_square("v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0 nan nan nan\nv 0 0.1 0\nf 1 2 3 4\n",
                ElementsAre(HasSubstr("line 3: a vertex colour is not of finite numbers")));
}

TEST_F(ObjModelFile, SkipsByteOrderMark) {
  expect_square("\xEF\xBB\xBF" + kCorners + "v 5 5 0\nf 1 2 3 4\n", IsEmpty());
  EXPECT_EQ(color_of("\xEF\xBB\xBF" + kRed), glm::vec4(1, 0, 0, 1));
}

TEST_F(ObjModelFile, ReportsUtf16Text) {
  std::string utf16 = "\xFF\xFE";
  for (const char c : kCorners) utf16 += {c, '\0'};
  const Result<Model> model = folder_.obj(utf16);
  ASSERT_FALSE(model);
  EXPECT_THAT(model.error().message, HasSubstr("model.obj: is UTF-16 text; save it as UTF-8"));
  std::string warning;
  EXPECT_EQ(color_of("\xFF\xFEn\0e\0", &warning).r, 0.6F);
  EXPECT_THAT(warning, HasSubstr("m.mtl: is UTF-16 text"));
}

TEST_F(ObjModelFile, AcceptsColoursOfOneOrMoreThanThreeNumbers) {
  EXPECT_NEAR(color_of("newmtl red\nKd 0.5\n").b, 0.21404F, 1e-4F);
  EXPECT_EQ(color_of("newmtl red\nKd 1 0 0 # red\n"), glm::vec4(1, 0, 0, 1));
  std::string warning;
  EXPECT_EQ(color_of("newmtl red\nKd 1 0 0 1\n", &warning), glm::vec4(1, 0, 0, 1));
  EXPECT_THAT(warning, HasSubstr("m.mtl: line 2: Kd has over three numbers"));
}

TEST_F(ObjModelFile, ReportsAndIgnoresInvalidColours) {
  for (const std::string form : {"spectral file.rfl", "xyz 1 1 1", "nan 0 0", "-1 0 0", ""}) {
    std::string warning;
    EXPECT_EQ(color_of("newmtl red\nKd " + form + "\n", &warning), glm::vec4(0.6F, 0.6F, 0.6F, 1))
        << form;
    EXPECT_THAT(warning, HasSubstr("m.mtl: line 2: Kd is not a colour")) << form;
  }
}

TEST_F(ObjModelFile, ReportsIgnoredMaterialLinesOncePerKind) {
  // Highlights and refraction are not drawn; their keywords give no warning.
  EXPECT_EQ(color_of(kRed + "Ka 1 1 1\nKs 1 1 1\nNs 90\nNi 1.5\nillum 2\nsharpness 60\nTf 1 1 1\n"),
            glm::vec4(1, 0, 0, 1));
  for (const std::string key :
       {"map_Ks", "map_Bump", "bump", "norm", "disp", "decal", "refl", "map_Pr", "Pcr"}) {
    std::string warning;
    const std::string line = key + " -type sphere t.png\n";
    EXPECT_EQ(color_of(kRed + line + line, &warning), glm::vec4(1, 0, 0, 1));
    EXPECT_THAT(warning, HasSubstr("m.mtl: line 3: " + key + " is ignored (2 such lines)"));
  }
  std::string warning;
  EXPECT_EQ(color_of(kRed + "fnord 1\nKD 0 0 0\n", &warning), glm::vec4(1, 0, 0, 1));
  EXPECT_THAT(warning, HasSubstr("m.mtl: line 3: a line does not start with a word of the MTL "
                                 "format and is skipped (2 such lines)"));
  EXPECT_EQ(color_of("Kd 0 0 0\n" + kRed, &warning), glm::vec4(1, 0, 0, 1));
  EXPECT_THAT(warning, HasSubstr("m.mtl: line 1: a line before the first newmtl is skipped"));
}

TEST_F(ObjModelFile, ReadsMaterialFileOnce) {
  folder_.write("m.mtl", kRed + "fnord\n");
  for (const std::string file : {"m.mtl", "gone.mtl"}) {
    std::string text = "mtllib " + file + "\n" + kCorners + kRedSquare;
    for (int i = 0; i < 1000; ++i) text += "mtllib ./" + file + "\n";
    expect_square(text, ElementsAre(HasSubstr(file)));
  }
}

TEST_F(ObjModelFile, ReadsTinyNumbersAsZero) {
  const std::string zeros(400, '0');
  for (const std::string& tiny :
       {std::string("1e-400"), std::string("-1e-400"), std::string("1e-99999999999999999999"),
        "0." + zeros + "1", "0." + zeros + "1e+9", "1" + zeros + "e-999"}) {
    expect_square("v 0 0 " + tiny + "\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\nf 1 2 3 4\n", IsEmpty());
  }
  for (const std::string& vast :
       {std::string("1e400"), std::string("-1e400"), std::string("1e99999999999999999999"),
        "1" + zeros, "1" + zeros + "e-9", "0." + zeros + "1e999"}) {
    EXPECT_FALSE(folder_.obj("v 0 0 " + vast + "\n" + kCorners + "f 1 2 3 4\n")) << vast;
  }
}

TEST_F(ObjModelFile, AcceptsPlusSigns) {
  expect_square("v +0 0 0\nv +0.1 0 0\nv 0.1 +1e-1 0\nv 0 0.1 0\nf +1 +2 3 +4\n", IsEmpty());
  EXPECT_FALSE(folder_.obj(kCorners + "f +1 +-2 3 4\n"));
  EXPECT_FALSE(folder_.obj(kCorners + "f ++1 2 3 4\n"));
  EXPECT_FALSE(folder_.obj(kCorners + "f + 2 3 4\n"));
}

TEST_F(ObjModelFile, TreatsHaloAsOpacity) {
  std::string warning;
  const Material material = material_of(kRed + "d -halo 0.5\n", &warning);
  EXPECT_EQ(material.base_color.a, 0.5F);
  EXPECT_EQ(material.alpha_mode, AlphaMode::blend);
  EXPECT_THAT(warning, HasSubstr("-halo"));
}

TEST_F(ObjModelFile, ResolvesMaterialFileNames) {
  folder_.write("red.mtl", kRed);
  folder_.write("blue.mtl", "newmtl blue\nKd 0 0 1\n");
  folder_.write("my red.mtl", kRed);
  for (const std::string name :
       {"red.mtl", ".\\red.mtl", "red.mtl blue.mtl", "blue.mtl red.mtl", "my red.mtl",
        "my\\ red.mtl", "\"my red.mtl\"", "red.mtl # a comment", "blue.mtl my\\ red.mtl"}) {
    const Result<Model> model = folder_.obj("mtllib " + name + "\r\n" + kCorners + kRedSquare);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_THAT(model->warnings, IsEmpty()) << name;
    EXPECT_EQ(model->meshes[0].name, "red") << name;
  }
}

TEST_F(ObjModelFile, UsesMaterialFileBesideModelWhenPathLeavesFolder) {
  for (const std::string name : {"../red.mtl", "C:\\models\\red.mtl", "/models/red.mtl"}) {
    std::filesystem::remove(folder_.path() / "red.mtl");
    Result<Model> model = folder_.obj("mtllib " + name + "\n" + kCorners + kRedSquare);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_THAT(model->warnings,
                ElementsAre(AllOf(HasSubstr("line 1: there is no"), HasSubstr("plain grey"))));
    folder_.write("red.mtl", kRed);
    model = folder_.obj("mtllib " + name + "\n" + kCorners + kRedSquare);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_EQ(model->meshes[0].name, "red") << name;
    EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("is outside the model's folder")));
  }
}

TEST_F(ObjModelFile, ReportsUnknownMaterial) {
  folder_.write("m.mtl", kRed);
  expect_square("mtllib m.mtl\n" + kCorners + "usemtl rde\nf 1 2 3 4\n",
                ElementsAre(HasSubstr("material \"rde\" is in no material file")));
}

TEST_F(ObjModelFile, AcceptsNamesWithBlanksAndOtherEncodings) {
  folder_.write("m.mtl", "newmtl my gr\xFCn\nKd 0 1 0\n");
  const Result<Model> model =
      folder_.obj("mtllib m.mtl\no T\xF6pfchen\n" + kCorners + "usemtl my gr\xFCn\nf 1 2 3 4\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->meshes[0].name, "my gr\xC3\xBCn");
  EXPECT_EQ(model->nodes[0].name, "T\xC3\xB6pfchen");
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(ObjModelFile, FallsBackToPlainColourWithoutImage) {
  folder_.write("t.tga", std::string("\0\0\2\0\0\0\0\0\0\0\0\0\1\0\1\0\30\0abc", 21));
  const std::string png = test::png_bytes(test::one_color(200, 90, 30));
  folder_.write("half.png", png.substr(0, png.size() / 2));
  std::filesystem::create_directory(folder_.path() / "folder.png");
  for (const std::string name : {"gone.png", "t.tga", "half.png", "folder.png",
                                 "C:\\Users\\me\\t.png", "..", "http://x.org/gone.png"}) {
    std::string warning;
    EXPECT_EQ(color_of(kRed + "map_Kd " + name + "\n", &warning), glm::vec4(1, 0, 0, 1)) << name;
    EXPECT_THAT(warning, AllOf(HasSubstr("material \"red\""), HasSubstr("drawn in plain colour")));
  }
  EXPECT_EQ(color_of(kRed + "newmtl other\nmap_Kd gone.png\n"), glm::vec4(1, 0, 0, 1))
      << "an image that no face uses is not searched for";
}

TEST_F(ObjModelFile, ResolvesImageNames) {
  const auto bytes = test::png_bytes(test::one_color(200, 90, 30));
  const std::string png(bytes.begin(), bytes.end());
  folder_.write("t.png", png);
  folder_.write("my wood.png", png);
  for (const std::string name :
       {"t.png", ".\\t.png", "my wood.png", "my\\ wood.png", "-s 1 1 1 -o 0 0 0 t.png",
        "-clamp on my wood.png", "-s 1 -bm 0.5 -mm 0 1 -blendu on -imfchan r t.png",
        "t.png # a comment"}) {
    const Material material = material_of(kRed + "map_Kd " + name + "\n");
    EXPECT_EQ(material.base_color_texture.image, 0) << name;
    EXPECT_EQ(material.base_color_texture.sampling.wrap_s == TextureWrap::clamp,
              name.starts_with("-clamp"));
  }
  std::string warning;
  EXPECT_EQ(material_of(kRed + "map_Kd -s 2 2 2 t.png\n", &warning).base_color_texture.image, 0);
  EXPECT_THAT(warning, HasSubstr("the option -s of map_Kd is ignored"));
  EXPECT_EQ(material_of(kRed + "map_Kd C:\\me\\t.png\n", &warning).base_color_texture.image, 0);
  EXPECT_THAT(warning, HasSubstr("is outside the model's folder"));
}

TEST_F(ObjModelFile, RejectsFaceWithInvalidCorner) {
  for (const std::string face : {"f 1 2 5", "f 1 2 0", "f 1 2 -5", "f 1 2 x", "f 1 2 3/1/1/1"}) {
    const Result<Model> model = folder_.obj(kCorners + face + "\n");
    ASSERT_FALSE(model) << face;
    EXPECT_THAT(model.error().message, HasSubstr("model.obj: line 5: ")) << face;
  }
}

// Damages model and material files. Each message about them must be a single line.
TEST_F(ObjModelFile, ReportsDamageInOneLine) {
  std::string obj = "mtllib m.mtl\no thing\nusemtl red\n", face = "f";
  for (int i = 0; i < 24; ++i) {
    obj += fmt::format("v {} {} {} 1 0.5 0\nvt {} 0.5\nvn 0 0 1\n", (i * 7) % 24 * 0.01,
                       (i * 5) % 24 * 0.01, i % 3 * 0.001, 0.04 * i);
    face += fmt::format(" {0}/{0}/{0}", i + 1);
  }
  obj += face + "\nf 1/1 2/2 3/3 4/4 5/5\nf 1//1 2//2 3//3 4//4\nusemtl blue\nf 1 2 3\nl 1 2\n";
  const std::string mtl =
      "newmtl red\nKd 1 0 0\nd -halo 0.5\nmap_Kd -s 1 1 1 -clamp on t.png\nnewmtl blue\nKd 0.5\n";
  test::Random random(5);
  int accepted = 0;
  for (int i = 0; i < 4000; ++i) {
    for (const std::string name : {"model.obj", "m.mtl"}) {
      std::filesystem::remove(folder_.path() / name);
    }
    const auto damaged = [&](const std::string& text) {
      return test::mutated(text, random,
                           {"nan", "-1", "1e39", "99999999999", "0", "../x", "1e300", "-inf", "f",
                            "1/1/1", "\\", "#", "newmtl", "spectral", "\"", "1e-320"});
    };
    folder_.write("m.mtl", damaged(mtl));
    const Result<Model> model = folder_.obj(random.below(4) == 0 ? obj : damaged(obj));
    if (!model) {
      EXPECT_EQ(model.error().message.find('\n'), std::string::npos) << model.error().message;
      EXPECT_THAT(model.error().message, HasSubstr("model.obj"));
      continue;
    }
    ++accepted;
    EXPECT_TRUE(std::isfinite(area_of(*model)));
    for (const std::string& warning : model->warnings) {
      EXPECT_EQ(warning.find('\n'), std::string::npos) << warning;
    }
  }
  EXPECT_GT(accepted, 1000);
  EXPECT_LT(accepted, 4000);
}

TEST(ObjModelFileCases, MatchAreaOfSharedFiles) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared cases beside the checkout";
  const std::filesystem::path cases = test::shared_dir() / "cases";
  int count = 0;
  for (const std::string folder : {"obj-face-corner-forms", "obj-byte-order-mark",
                                   "model-refused-for-its-pictures", "obj-mtl-legal-forms"}) {
    for (const auto& entry : std::filesystem::directory_iterator(cases / folder)) {
      if (entry.path().extension() != ".obj" || entry.path().stem() == "ngon300") continue;
      const Result<Model> model = load_model(entry.path());
      ASSERT_TRUE(model) << model.error().message;
      EXPECT_NEAR(area_of(*model), 0.01, 1e-8) << entry.path();
      EXPECT_LE(model->warnings.size(), 1U) << entry.path();
      ++count;
      const std::string name = entry.path().stem().string();
      const Material& material =
          model->materials.at(static_cast<std::size_t>(model->meshes[0].material));
      if (folder == "obj-byte-order-mark" && !name.starts_with("bom_v")) {
        EXPECT_EQ(material.base_color, glm::vec4(1, 0, 0, 1)) << name;
        EXPECT_THAT(model->warnings, IsEmpty()) << name;
      }
      if (name == "m_texmissing" || name == "m_textga" || name == "mtllib_two" ||
          name == "mtllib_dotbackslash" || name == "mtllib_up" || name == "m_texunused") {
        EXPECT_EQ(material.base_color, glm::vec4(1, 0, 0, 1)) << name;
      }
      if (name == "m_texabs" || name == "m_texdotbackslash") {
        EXPECT_EQ(material.base_color_texture.image, 0) << name;
      }
    }
  }
  EXPECT_EQ(count, 29);
}

}  // namespace
}  // namespace penumbra
