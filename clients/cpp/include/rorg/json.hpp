// As much JSON as rorg's answers need: parse, look up, quote.
#pragma once

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <locale>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace rorg::json {

struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A JSON value. Looking up what is not there gives null, so chains of look-ups never throw.
class Value {
 public:
  enum class Kind { null, boolean, number, string, array, object };
  Kind kind = Kind::null;
  bool flag = false;
  double number = 0;
  std::string string;
  std::vector<Value> items;
  std::map<std::string, Value> fields;

  const Value& operator[](const std::string& key) const {
    const auto found = fields.find(key);
    return found == fields.end() ? none() : found->second;
  }
  const Value& operator[](std::size_t index) const { return index < items.size() ? items[index] : none(); }
  std::size_t size() const { return kind == Kind::object ? fields.size() : items.size(); }
  bool is_null() const { return kind == Kind::null; }
  explicit operator bool() const { return kind == Kind::boolean ? flag : kind != Kind::null; }
  const std::string& text() const { return string; }

 private:
  // Never destroyed: a thread that outlives main() may still look something up.
  static const Value& none() {
    static const Value* const value = new Value;
    return *value;
  }
};

inline std::string quoted(const std::string& text) {
  std::string found = "\"";
  for (const char one : text) {
    const auto c = static_cast<unsigned char>(one);
    if (c == '"' || c == '\\') {
      found += '\\';
      found += static_cast<char>(c);
    } else if (c < 0x20) {
      char code[8];
      std::snprintf(code, sizeof(code), "\\u%04x", c);
      found += code;
    } else {
      found += static_cast<char>(c);
    }
  }
  return found + "\"";
}

class Parser {
 public:
  explicit Parser(const std::string& text) : text_(text) {}
  Value all() {
    Value value = one(0);
    space();
    if (at_ != text_.size()) throw Error("more after the end");
    return value;
  }

 private:
  static constexpr int deepest = 200;
  void space() {
    while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_]))) ++at_;
  }
  char next() {
    space();
    if (at_ >= text_.size()) throw Error("unexpected exit");
    return text_[at_];
  }
  void expect(char c) {
    if (next() != c) throw Error(std::string("expected ") + c);
    ++at_;
  }
  bool word(const char* text) {
    const std::string w(text);
    if (text_.compare(at_, w.size(), w) != 0) return false;
    at_ += w.size();
    return true;
  }
  Value one(int depth) {
    if (depth > deepest) throw Error("too deep");
    Value value;
    const char c = next();
    if (c == '{') {
      object(value, depth);
    } else if (c == '[') {
      array(value, depth);
    } else if (c == '"') {
      value.kind = Value::Kind::string;
      value.string = string();
    } else if (word("true") || word("false")) {
      value.kind = Value::Kind::boolean;
      value.flag = text_[at_ - 2] == 'u';
    } else if (!word("null")) {
      value.kind = Value::Kind::number;
      value.number = number();
    }
    return value;
  }
  // Not by strtod, which reads by the program's locale: in a German one, 0.5 is 0.
  double number() {
    const std::size_t end = std::min(text_.find_first_not_of("+-.0123456789eE", at_), text_.size());
    std::istringstream stream(text_.substr(at_, end - at_));
    stream.imbue(std::locale::classic());
    double found = 0;
    if (end == at_ || !(stream >> found)) throw Error("not a value");
    at_ = end;
    return found;
  }
  void object(Value& value, int depth) {
    value.kind = Value::Kind::object;
    ++at_;
    if (next() == '}') {
      ++at_;
      return;
    }
    for (;;) {
      if (next() != '"') throw Error("expected a key");
      std::string key = string();
      expect(':');
      value.fields[std::move(key)] = one(depth + 1);
      if (next() == '}') break;
      expect(',');
    }
    ++at_;
  }
  void array(Value& value, int depth) {
    value.kind = Value::Kind::array;
    ++at_;
    if (next() == ']') {
      ++at_;
      return;
    }
    for (;;) {
      value.items.push_back(one(depth + 1));
      if (next() == ']') break;
      expect(',');
    }
    ++at_;
  }
  unsigned code() {
    if (at_ + 4 > text_.size()) throw Error("unexpected exit");
    const auto found = static_cast<unsigned>(std::strtoul(text_.substr(at_, 4).c_str(), nullptr, 16));
    at_ += 4;
    return found;
  }
  static void append(std::string& out, unsigned c) {
    if (c < 0x80) {
      out += static_cast<char>(c);
    } else if (c < 0x800) {
      out += static_cast<char>(0xC0 | (c >> 6));
      out += static_cast<char>(0x80 | (c & 0x3F));
    } else if (c < 0x10000) {
      out += static_cast<char>(0xE0 | (c >> 12));
      out += static_cast<char>(0x80 | ((c >> 6) & 0x3F));
      out += static_cast<char>(0x80 | (c & 0x3F));
    } else {
      out += static_cast<char>(0xF0 | (c >> 18));
      out += static_cast<char>(0x80 | ((c >> 12) & 0x3F));
      out += static_cast<char>(0x80 | ((c >> 6) & 0x3F));
      out += static_cast<char>(0x80 | (c & 0x3F));
    }
  }
  std::string string() {
    std::string found;
    for (++at_; at_ < text_.size() && text_[at_] != '"'; ++at_) {
      if (text_[at_] != '\\') {
        found += text_[at_];
        continue;
      }
      if (++at_ >= text_.size()) break;
      switch (const char c = text_[at_]) {
        case 'n': found += '\n'; break;
        case 't': found += '\t'; break;
        case 'r': found += '\r'; break;
        case 'b': found += '\b'; break;
        case 'f': found += '\f'; break;
        case 'u': {
          ++at_;
          unsigned first = code();
          if (first >= 0xD800 && first < 0xDC00 && text_.compare(at_, 2, "\\u") == 0) {
            at_ += 2;
            first = 0x10000 + ((first - 0xD800) << 10) + (code() - 0xDC00);
          }
          append(found, first);
          --at_;
          break;
        }
        default: found += c;
      }
    }
    if (at_ >= text_.size()) throw Error("unexpected exit");
    ++at_;
    return found;
  }
  const std::string& text_;
  std::size_t at_ = 0;
};

inline Value parse(const std::string& text) { return Parser(text).all(); }

}  // namespace rorg::json
